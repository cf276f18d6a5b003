//! The motors' log: where each axis stood when a pair was taken, and which stand of the board it shows.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use vergence_calib::solve::{AXES, AXIS_NAMES, MotorState};

use super::lists::View;
use super::table::Table;
use crate::fault::{self, Fault};
use crate::output;

/// Largest log that is read, bytes.
const MAX_LOG_BYTES: u64 = 16 << 20;

/// A read log.
pub(super) struct Log {
    /// Of the left and of the right camera, by the name of a file: stand of the board and state of the motors.
    rows: [BTreeMap<String, (usize, MotorState)>; 2],
}

impl Log {
    /// Read a log and see that it fits the pictures.
    pub(super) fn read(path: &Path, views: &[View]) -> Result<Self, Fault> {
        let text = output::read_text(path, "motor log", MAX_LOG_BYTES)
            .map_err(|e| fault::usage(e.to_string()))?;
        let log = Self::parse(&text)
            .map_err(|e| fault::usage(format!("motor log {}: {e}", path.display())))?;
        let missing = views
            .iter()
            .find(|v| !log.rows[v.camera].contains_key(&file_name(&v.path)));
        if let Some(view) = missing {
            return Err(fault::usage(format!(
                "motor log {}: there is no row for {}",
                path.display(),
                view.path.display()
            ))
            .hint("every pair needs one row with the names of both files"));
        }
        let known: BTreeSet<(usize, String)> = views
            .iter()
            .map(|v| (v.camera, file_name(&v.path)))
            .collect();
        let strange = log.rows.iter().enumerate().find_map(|(camera, rows)| {
            rows.keys()
                .find(|name| !known.contains(&(camera, (*name).clone())))
        });
        if let Some(name) = strange {
            return Err(fault::usage(format!(
                "motor log {}: it has a row for {name}, which is not among the pictures",
                path.display()
            ))
            .hint("it belongs to other pictures, or some were left out: remove its row too"));
        }
        Ok(log)
    }

    fn parse(text: &str) -> Result<Self, String> {
        let table = Table::parse(text)?;
        let column = |name: &str| table.column(name);
        let needed = |name: &str| {
            column(name).ok_or_else(|| {
                format!(
                    "it has no column {name}; needed are left, right, place, pan_steps, tilt_steps, left_steps, right_steps"
                )
            })
        };
        let files = [needed("left")?, needed("right")?];
        let place = needed("place")?;
        let mut steps = [0; AXES];
        let mut approach = [None; AXES];
        for (i, axis) in AXIS_NAMES.iter().enumerate() {
            steps[i] = needed(&format!("{axis}_steps"))?;
            approach[i] = column(&format!("{axis}_approach"));
        }
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        let mut rows = [BTreeMap::new(), BTreeMap::new()];
        for row in table.rows() {
            let number_at = |at: usize| table.number(row, at);
            let mut state = MotorState::default();
            for i in 0..AXES {
                state.steps[i] = number_at(steps[i])?;
                if let Some(at) = approach[i] {
                    state.approach[i] = number_at(at)?.clamp(-1.0, 1.0);
                }
            }
            let next = places.len();
            let placement = *places.entry(row.text(place).to_owned()).or_insert(next);
            for (rows, at) in rows.iter_mut().zip(files) {
                let name = file_name(Path::new(row.text(at)));
                if rows.insert(name.clone(), (placement, state)).is_some() {
                    return Err(format!(
                        "line {} names {name}, which another row names",
                        row.line
                    ));
                }
            }
        }
        Ok(Self { rows })
    }

    /// Stand of the board and state of the motors of a picture that [`Self::read`] has seen.
    pub(super) fn of(&self, view: &View) -> (usize, MotorState) {
        self.rows[view.camera][&file_name(&view.path)]
    }
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str =
        "left,right,place,pan_steps,tilt_steps,left_steps,right_steps,left_approach\n";

    /// Rows, places in their order, approaches; and every fault is told with its line.
    #[test]
    fn logs_are_read() {
        let log = Log::parse(&format!(
            "# of 1 May\n{HEAD}l1.png,r1.png,a,0,0,10,-10,1\nl2.png,r2.png,b,5,0,20,-10,-1\n"
        ))
        .unwrap();
        assert_eq!(log.rows[0].len(), 2);
        let (placement, state) = log.rows[1]["r2.png"];
        assert_eq!(placement, 1);
        assert_eq!(state.steps, [5.0, 0.0, 20.0, -10.0]);
        assert_eq!(state.approach, [0.0, 0.0, -1.0, 0.0]);
        for (text, told) in [
            ("", "empty"),
            ("left,right\n", "no column place"),
            (
                &*format!("{HEAD}l.png,r.png,a,0,0,x,0,1\n"),
                "line 2, column left_steps",
            ),
            (&*format!("{HEAD}l.png,r.png,a,0,0\n"), "has 5 values"),
            (
                &*format!("{HEAD}l.png,r.png,a,0,0,0,0,1\nl.png,r2.png,a,0,0,0,0,1\n"),
                "another row",
            ),
        ] {
            let error = Log::parse(text).err().unwrap();
            assert!(error.contains(told), "{error}");
        }
    }
}
