//! A rig to try `vergence run` on without a rig: two live streams of a walking person, as seen by cameras that stand on the axes of a simulated Grbl
//! controller. Needs `ffmpeg`, for the program that reads the streams.
//!
//! ```text
//! cargo run --profile quick -p vergence --example rig-on-the-table -- 20
//! ```
//!
//! takes 20 pairs a second and prints the call that drives it, until Ctrl-C. Type `unplug left` or `plug left` to pull a camera's plug, `where` for the axes and
//! how far the person is from zero parallax.

#[path = "../tests/table/mod.rs"]
mod table;

use std::io::BufRead as _;

use vergence_geometry::Eye;

fn main() -> std::io::Result<()> {
    let fps = std::env::args().nth(1).and_then(|text| text.parse().ok());
    let folder = std::env::temp_dir().join(format!("rig-on-the-table-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let walk = folder.join("walk.csv");
    std::fs::write(&walk, table::walk(table::TO_AND_FRO))?;
    let table = table::Table::start(&folder, &walk, fps.unwrap_or(20.0));
    println!(
        "vergence run {} --home --mode converged",
        table.flags().join(" ")
    );
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["plug", "left"] => table.plug(Eye::Left, true),
            ["plug", "right"] => table.plug(Eye::Right, true),
            ["unplug", "left"] => table.plug(Eye::Left, false),
            ["unplug", "right"] => table.plug(Eye::Right, false),
            ["where"] => {
                let now_s = table.axes.now_s();
                let newest = table.truths(now_s - 1.0, now_s).pop();
                let error_px = newest.and_then(|truth| truth.disparity_px());
                println!(
                    "{:.3?} degrees, {error_px:.2?} px",
                    table.axes.angles_deg(now_s)
                );
            }
            _ => println!("unknown: {line}"),
        }
    }
    // Without a keyboard it serves until it is ended.
    loop {
        std::thread::park();
    }
}
