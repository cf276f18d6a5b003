//! Files of points in, CSV (or JSON) out.

use std::fmt::Write;
use std::path::Path;

use serde_json::json;
use vergence_geometry::cases::CaseResult;
use vergence_geometry::planning::Setup;

use super::{FILE_LIMIT_BYTES, point};
use crate::fault;
use crate::output::{self, Format};
use crate::rig;
use crate::settings::quantity::Dimension;

const HEADER: &str = "x0,y0,z0,state,depth_l,depth_r,pan_l_deg,pan_r_deg,left_x,left_y,right_x,right_y,p,q,h_paper,v_paper,\
perceived_x,perceived_y,perceived_z,closest3d_x,closest3d_y,closest3d_z,ray_gap,disparity_arcmin,vdisparity_arcmin\n";

/// Read all points, then answer for all; nothing is printed when one of them is faulty.
pub(super) fn run(setup: &Setup, path: &Path, format: Format) -> anyhow::Result<()> {
    let text = output::read_text(path, "file of points", FILE_LIMIT_BYTES)?;
    let points =
        parse(&text).map_err(|e| fault::usage(format!("file of points {} {e}", path.display())))?;
    let views = setup.array.views().map_err(rig::refused)?;
    let mut rows = Vec::with_capacity(points.len());
    for (line, point) in &points {
        let sight = views
            .sight(*point, &setup.screen, &setup.viewer)
            .map_err(|e| {
                fault::usage(format!(
                    "file of points {} line {line}: {e}",
                    path.display()
                ))
            })?;
        rows.push(CaseResult::from(sight));
    }
    match format {
        Format::Text => {
            let mut out = String::from(HEADER);
            for ((_, point), row) in points.iter().zip(&rows) {
                push_row(&mut out, *point, row);
            }
            output::print(&out)?;
            Ok(())
        }
        Format::Json => {
            let cases: Vec<_> = points
                .iter()
                .zip(&rows)
                .map(|((line, point), row)| {
                    point::case_json(setup, &format!("line {line}"), *point, row)
                })
                .collect();
            output::print_json(&json!({ "cases": cases }))
        }
    }
}

/// Line number and point of each line that holds one.
fn parse(text: &str) -> Result<Vec<(usize, [f64; 3])>, String> {
    let mut points = Vec::new();
    let mut columns: Option<[usize; 3]> = None;
    let mut count = 3;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (i, line) in text.lines().enumerate() {
        let line_number = i + 1;
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        if columns.is_none() {
            if cells.iter().any(|c| is_name(c)) {
                columns = Some(named(&cells).map_err(|e| format!("line {line_number}: {e}"))?);
                count = cells.len();
                continue;
            }
            columns = Some([0, 1, 2]);
        }
        if cells.len() != count {
            return Err(format!(
                "line {line_number}: {} cells, not {count}",
                cells.len()
            ));
        }
        let mut point = [0.0; 3];
        for ((slot, column), name) in point
            .iter_mut()
            .zip(columns.unwrap_or([0, 1, 2]))
            .zip(["x", "y", "z"])
        {
            let cell = cells[column];
            *slot = Dimension::Length
                .parse(cell)
                .map_err(|why| format!("line {line_number}: {name} = '{cell}' {why}"))?;
        }
        points.push((line_number, point));
    }
    if points.is_empty() {
        return Err("holds no point; write lines x,y,z".to_owned());
    }
    Ok(points)
}

/// Whether a cell of the first line is a column's name. "nan" and "inf" are bad numbers, not names.
fn is_name(cell: &str) -> bool {
    let word = cell.trim_matches('"').to_lowercase();
    word.starts_with(|c: char| c.is_alphabetic())
        && !matches!(word.as_str(), "nan" | "inf" | "infinity")
}

/// Columns of x, y, z by their names.
fn named(cells: &[&str]) -> Result<[usize; 3], String> {
    let find = |name: &str| {
        let also = format!("{name}0");
        cells
            .iter()
            .map(|c| c.trim_matches('"').to_lowercase())
            .position(|c| c == name || c == also)
            .ok_or_else(|| format!("the header names no column {name}; it must name x, y and z"))
    };
    Ok([find("x")?, find("y")?, find("z")?])
}

fn push_row(out: &mut String, point: [f64; 3], row: &CaseResult) {
    let pair = |v: Option<[f64; 2]>| v.map_or([None; 2], |v| v.map(Some));
    let triple = |v: Option<[f64; 3]>| v.map_or([None; 3], |v| v.map(Some));
    let mut cells: Vec<Option<f64>> = vec![
        Some(row.depth_l),
        Some(row.depth_r),
        Some(row.pan_l_deg),
        Some(row.pan_r_deg),
    ];
    cells.extend(pair(row.left));
    cells.extend(pair(row.right));
    cells.extend([row.p, row.q, row.h_paper, row.v_paper]);
    cells.extend(triple(row.perceived));
    cells.extend(triple(row.closest3d));
    cells.extend([row.ray_gap, row.disparity_arcmin, row.vdisparity_arcmin]);
    // A string takes every write.
    let _ = write!(
        out,
        "{},{},{},{}",
        point[0],
        point[1],
        point[2],
        row.state.name()
    );
    for cell in cells {
        match cell {
            Some(value) => {
                let _ = write!(out, ",{value}");
            }
            None => out.push(','),
        }
    }
    out.push('\n');
}

#[cfg(test)]
mod tests {
    //! What a file of points may look like, and that errors name the line.
    use super::*;

    #[test]
    fn header_units_comments_and_blank_lines_are_understood() {
        let plain = parse("1,2,3\n\n# a comment\n-0.5, 0 ,70mm\n").unwrap();
        assert_eq!(plain, [(1, [1.0, 2.0, 3.0]), (4, [-0.5, 0.0, 0.07])]);
        let named = parse("\u{feff}id,Z0,x0,y0\r\n7,3,1,2\r\n").unwrap();
        assert_eq!(named, [(2, [1.0, 2.0, 3.0])]);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, says) in [
            ("1,2,3\n1,2\n", "line 2: 2 cells, not 3"),
            ("1,2,3\n1,nan,3\n", "line 2: y = 'nan' is no length"),
            ("nan,2,3\n", "line 1: x = 'nan'"),
            ("x,y,w\n1,2,3\n", "names no column z"),
            ("", "holds no point"),
            ("x,y,z\n", "holds no point"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(says), "{text:?}: {error}");
        }
    }
}
