//! Matching, and matching with all geometry, of one rendered pair on one core, from 160 x 120 to 4000 x 3000.

#[path = "../tests/faults/leaves/mod.rs"]
mod leaves;

use leaves::Leaves;
use vergence_geometry::comfort::Viewing;
use vergence_geometry::viewing::Viewer;
use vergence_imaging::colour::luma_from_rgb;
use vergence_stereo::faults::{Conditions, matching::matched, measure};

fn main() {
    divan::main();
}

/// Widths; the height is three quarters.
const WIDTHS: [usize; 4] = [160, 640, 1024, 4000];

#[divan::bench(args = WIDTHS, sample_count = 10, sample_size = 1)]
fn matching(bencher: divan::Bencher, width: usize) {
    let [left, right] = Leaves::new(1).pair((width, width * 3 / 4));
    let [left, right] = [luma_from_rgb(&left), luma_from_rgb(&right)];
    bencher.bench_local(|| matched(&left, &right));
}

#[divan::bench(args = WIDTHS, sample_count = 10, sample_size = 1)]
fn geometry(bencher: divan::Bencher, width: usize) {
    let [left, right] = Leaves::new(1).pair((width, width * 3 / 4));
    let conditions = Conditions::new(Viewing {
        viewer: Viewer::default(),
        screen_width_m: 0.5,
        width_px: width,
    });
    bencher.bench_local(|| measure(&left, &right, &conditions));
}
