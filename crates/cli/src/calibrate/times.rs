//! When pictures were taken: a table with a row for every pair (or group of several cameras).

use std::path::Path;

use super::lists::View;
use super::table::Table;
use crate::fault::{self, Fault};
use crate::output;

/// Largest table that is read, bytes.
const MAX_TIMES_BYTES: u64 = 16 << 20;

/// Seconds of every view on a clock that all cameras share.
pub(super) fn read(path: &Path, names: &[String], views: &[View]) -> Result<Vec<f64>, Fault> {
    let text = output::read_text(path, "table of times", MAX_TIMES_BYTES)
        .map_err(|e| fault::usage(e.to_string()))?;
    let told = |e: String| fault::usage(format!("table of times {}: {e}", path.display()));
    let rows = parse(&text, names).map_err(told)?;
    let groups = views.iter().map(|v| v.group + 1).max().unwrap_or(0);
    if rows.len() != groups {
        return Err(told(format!(
            "it has {} rows for {groups} pairs of pictures",
            rows.len()
        ))
        .hint("one row for every pair, in their order; every column time_NAME_s is a camera's"));
    }
    Ok(views.iter().map(|v| rows[v.group][v.camera]).collect())
}

/// Rows of the table: a time for each camera.
fn parse(text: &str, names: &[String]) -> Result<Vec<Vec<f64>>, String> {
    let table = Table::parse(text)?;
    let column = |name: &String| {
        let wanted = format!("time_{name}_s");
        let at = table.column(&wanted);
        at.ok_or_else(|| format!("it has no column {wanted}"))
    };
    let columns: Vec<usize> = names.iter().map(column).collect::<Result<_, _>>()?;
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for row in table.rows() {
        let times = columns.iter().map(|at| table.number(row, *at));
        let times: Vec<f64> = times.collect::<Result<_, _>>()?;
        if rows.last().is_some_and(|last| times[0] <= last[0]) {
            return Err(format!(
                "line {}: its time {} is not after the one before",
                row.line, times[0]
            ));
        }
        rows.push(times);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns are found by the cameras' names, others are passed over, and every fault is told with its line.
    #[test]
    fn times_are_read() {
        let names = ["left".to_owned(), "right".to_owned()];
        let head = "frame,time_right_s,time_left_s\n";
        let rows = parse(
            &format!("{head}1,0.5,0.25\n\n# a remark\n2,1.5,1.25\n"),
            &names,
        );
        assert_eq!(rows.unwrap(), [[0.25, 0.5], [1.25, 1.5]]);
        for (text, told) in [
            (String::new(), "empty"),
            ("time_left_s\n1\n".to_owned(), "no column time_right_s"),
            (format!("{head}1,x,0\n"), "line 2, column time_right_s"),
            (format!("{head}1,inf,0\n"), "line 2, column time_right_s"),
            (format!("{head}1,1\n"), "has 2 values"),
            (
                format!("{head}1,1,1\n2,2,1\n"),
                "line 3: its time 1 is not after",
            ),
        ] {
            let error = parse(&text, &names).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
