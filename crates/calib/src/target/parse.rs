//! Targets from a text as people type it, and from Kalibr's file.

use std::ops::RangeInclusive;

use super::{AprilGrid, Charuco, Chessboard, Dictionary, Target};
use crate::CalibError;

/// Corners, squares or tags along one side.
const SIDE: RangeInclusive<usize> = 1..=100;
/// Length of a square, a marker or a tag, metres: from a microscope's slide to a wall.
const LENGTH_M: RangeInclusive<f64> = 1e-5..=100.0;
/// Gap between tags over their side.
const SPACING: RangeInclusive<f64> = 0.01..=2.0;

const FORMS: &str = "a target is written chessboard:9x6:25mm (inner corners, square), \
    charuco:5x7:40mm:20mm:DICT_6X6_250 (squares, square, marker, dictionary; then :legacy, :inverted) or \
    aprilgrid:6x6:88mm:0.3 (tags, tag, gap over tag; then :first=0, :border=2)";

impl Target {
    /// A target from a text: `chessboard:9x6:25mm`, `charuco:5x7:40mm:20mm:DICT_6X6_250[:legacy][:inverted]` or
    /// `aprilgrid:6x6:88mm:0.3[:first=0][:border=2]`. Lengths have a unit: `mm`, `cm` or `m`.
    ///
    /// # Errors
    /// [`CalibError::Target`] with what is wrong and what would be right.
    pub fn parse(text: &str) -> Result<Self, CalibError> {
        let words: Vec<&str> = text.trim().split(':').map(str::trim).collect();
        let parsed = match words.as_slice() {
            ["chessboard", size, square] => chessboard(size, square),
            ["charuco", size, square, marker, dictionary, flags @ ..] => {
                charuco(size, square, marker, dictionary, flags)
            }
            ["aprilgrid", size, tag, spacing, flags @ ..] => aprilgrid(size, tag, spacing, flags),
            _ => Err(FORMS.to_owned()),
        };
        parsed
            .and_then(Self::checked)
            .map_err(|reason| CalibError::Target {
                text: text.trim().to_owned(),
                reason,
            })
    }

    /// A target from Kalibr's target file (`target_type: aprilgrid` or `checkerboard`).
    ///
    /// # Errors
    /// [`CalibError::Target`] with what is wrong.
    pub fn from_kalibr_yaml(text: &str) -> Result<Self, CalibError> {
        kalibr(text)
            .and_then(Self::checked)
            .map_err(|reason| CalibError::Target {
                text: "Kalibr's target file".to_owned(),
                reason,
            })
    }

    /// The target, if it can be printed and found.
    ///
    /// # Errors
    /// What is wrong and what would be right.
    pub(crate) fn checked(self) -> Result<Self, String> {
        let side = |what: &str, n: usize, least: usize| {
            if (least..=*SIDE.end()).contains(&n) {
                Ok(())
            } else {
                Err(format!(
                    "{n} {what} along a side; it must be {least} to {}",
                    SIDE.end()
                ))
            }
        };
        match &self {
            Target::Chessboard(b) => {
                side("inner corners", b.columns, 3)?;
                side("inner corners", b.rows, 3)?;
                length(b.square_m)?;
            }
            Target::Charuco(b) => {
                side("squares", b.columns, 3)?;
                side("squares", b.rows, 3)?;
                length(b.square_m)?;
                length(b.marker_m)?;
                if b.marker_m >= b.square_m {
                    return Err(format!(
                        "a marker of {} m does not fit into a square of {} m",
                        b.marker_m, b.square_m
                    ));
                }
                let markers = b.marked_squares().count();
                if markers > b.dictionary.count() {
                    return Err(format!(
                        "the board needs {markers} markers, {} has {}",
                        b.dictionary.name(),
                        b.dictionary.count()
                    ));
                }
            }
            Target::AprilGrid(b) => {
                side("tags", b.columns, 1)?;
                side("tags", b.rows, 1)?;
                length(b.tag_m)?;
                if !SPACING.contains(&b.spacing) {
                    return Err(format!(
                        "a gap of {} tags; it must be {} to {}",
                        b.spacing,
                        SPACING.start(),
                        SPACING.end()
                    ));
                }
                if !(1..=2).contains(&b.border) {
                    return Err(format!("a border of {} cells; it is 1 or 2", b.border));
                }
                let known = Dictionary::tag36h11().count();
                if b.first_id + b.columns * b.rows > known {
                    return Err(format!(
                        "tags {} to {} of 36h11, which has {known}",
                        b.first_id,
                        b.first_id + b.columns * b.rows - 1
                    ));
                }
            }
        }
        Ok(self)
    }
}

fn chessboard(size: &str, square: &str) -> Result<Target, String> {
    let (columns, rows) = size_from(size)?;
    Ok(Target::Chessboard(Chessboard {
        columns,
        rows,
        square_m: length_from(square)?,
    }))
}

fn charuco(
    size: &str,
    square: &str,
    marker: &str,
    dictionary: &str,
    flags: &[&str],
) -> Result<Target, String> {
    let (columns, rows) = size_from(size)?;
    let known = || {
        format!(
            "no dictionary is called {dictionary}; known are {}",
            Dictionary::names().join(", ")
        )
    };
    let mut board = Charuco {
        columns,
        rows,
        square_m: length_from(square)?,
        marker_m: length_from(marker)?,
        dictionary: Dictionary::named(dictionary).ok_or_else(known)?,
        legacy: false,
        inverted: false,
    };
    for flag in flags {
        match *flag {
            "legacy" => board.legacy = true,
            "inverted" => board.inverted = true,
            other => {
                return Err(format!(
                    "\"{other}\" is none of the words legacy and inverted"
                ));
            }
        }
    }
    Ok(Target::Charuco(board))
}

fn aprilgrid(size: &str, tag: &str, spacing: &str, flags: &[&str]) -> Result<Target, String> {
    let (columns, rows) = size_from(size)?;
    let mut board = AprilGrid {
        columns,
        rows,
        tag_m: length_from(tag)?,
        spacing: number_from(spacing)?,
        first_id: 0,
        border: 2,
    };
    for flag in flags {
        match flag.split_once('=') {
            Some(("first", n)) => board.first_id = count_from(n)?,
            Some(("border", n)) => board.border = count_from(n)?,
            _ => return Err(format!("\"{flag}\" is neither first=N nor border=N")),
        }
    }
    Ok(Target::AprilGrid(board))
}

/// Kalibr's file is YAML of one level; nothing else of YAML is needed to read it.
fn kalibr(text: &str) -> Result<Target, String> {
    let value = |key: &str| {
        text.lines()
            .map(|line| line.split('#').next().unwrap_or_default())
            .filter_map(|line| line.split_once(':'))
            .find(|(name, _)| name.trim() == key)
            .map(|(_, value)| value.trim().trim_matches(['"', '\'']))
            .ok_or_else(|| format!("it has no {key}"))
    };
    match value("target_type")? {
        "aprilgrid" => Ok(Target::AprilGrid(AprilGrid {
            columns: count_from(value("tagCols")?)?,
            rows: count_from(value("tagRows")?)?,
            tag_m: number_from(value("tagSize")?)?,
            spacing: number_from(value("tagSpacing")?)?,
            first_id: 0,
            border: 2,
        })),
        "checkerboard" => {
            let row_m = number_from(value("rowSpacingMeters")?)?;
            let column_m = number_from(value("colSpacingMeters")?)?;
            if row_m != column_m {
                return Err(format!(
                    "its squares are {column_m} x {row_m} m; they must be square"
                ));
            }
            Ok(Target::Chessboard(Chessboard {
                columns: count_from(value("targetCols")?)?,
                rows: count_from(value("targetRows")?)?,
                square_m: row_m,
            }))
        }
        other => Err(format!(
            "target_type {other} is not known; known are aprilgrid and checkerboard"
        )),
    }
}

fn size_from(text: &str) -> Result<(usize, usize), String> {
    let (columns, rows) = text
        .split_once(['x', 'X'])
        .ok_or_else(|| format!("\"{text}\" is no size; write columns x rows, as in 9x6"))?;
    Ok((count_from(columns)?, count_from(rows)?))
}

fn count_from(text: &str) -> Result<usize, String> {
    text.trim()
        .parse()
        .map_err(|_| format!("\"{text}\" is no whole number"))
}

fn number_from(text: &str) -> Result<f64, String> {
    text.trim()
        .parse()
        .ok()
        .filter(|v: &f64| v.is_finite())
        .ok_or_else(|| format!("\"{text}\" is no number"))
}

fn length_from(text: &str) -> Result<f64, String> {
    // The longer units first, since each ends in m.
    [("mm", 1000.0), ("cm", 100.0), ("m", 1.0)]
        .into_iter()
        .find_map(|(unit, per_m)| {
            text.strip_suffix(unit)
                .map(|n| number_from(n).map(|v| v / per_m))
        })
        .unwrap_or_else(|| {
            Err(format!(
                "\"{text}\" has no unit; write a length as 25mm, 2.5cm or 0.025m"
            ))
        })
}

fn length(metres: f64) -> Result<(), String> {
    if LENGTH_M.contains(&metres) {
        Ok(())
    } else {
        Err(format!(
            "a length of {metres} m; it must be {} to {} m",
            LENGTH_M.start(),
            LENGTH_M.end()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The forms that the help names, with their units, and back.
    #[test]
    fn texts_and_back() {
        for (text, same) in [
            ("chessboard:9x6:25mm", "chessboard:9x6:25mm"),
            ("chessboard:9X6:0.025m", "chessboard:9x6:25mm"),
            (
                "charuco:5x7:4cm:20mm:dict_6x6_250:legacy",
                "charuco:5x7:40mm:20mm:DICT_6X6_250:legacy",
            ),
            (
                "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
                "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
            ),
            ("aprilgrid:6x6:88mm:0.3", "aprilgrid:6x6:88mm:0.3"),
            (
                "aprilgrid:2x3:88mm:0.3:border=1:first=7",
                "aprilgrid:2x3:88mm:0.3:first=7:border=1",
            ),
        ] {
            assert_eq!(Target::parse(text).unwrap().text(), same);
        }
    }

    /// What is wrong is said with what would be right.
    #[test]
    fn faults_are_told() {
        for (text, part) in [
            ("", "chessboard:9x6:25mm"),
            ("chessboard:9x6:25", "no unit"),
            ("chessboard:9:25mm", "columns x rows"),
            ("chessboard:2x6:25mm", "3 to 100"),
            ("chessboard:9x6:-25mm", "a length of"),
            ("charuco:5x7:40mm:50mm:DICT_4X4_50", "does not fit"),
            ("charuco:5x7:40mm:20mm:DICT_9X9_50", "DICT_4X4_50"),
            ("charuco:20x20:40mm:20mm:DICT_4X4_50", "needs 200 markers"),
            (
                "charuco:5x7:40mm:20mm:DICT_4X4_50:old",
                "legacy and inverted",
            ),
            ("aprilgrid:30x30:88mm:0.3", "which has 587"),
            ("aprilgrid:6x6:88mm:0.3:border=3", "1 or 2"),
        ] {
            let message = Target::parse(text).unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }

    /// Kalibr's own examples.
    #[test]
    fn kalibr_files() {
        let grid = "target_type: 'aprilgrid' #gridtype\ntagCols: 6               #number of apriltags\ntagRows: 5\n\
                    tagSize: 0.088           #[m]\ntagSpacing: 0.3          #ratio of space between tags to tagSize\n";
        assert_eq!(
            Target::from_kalibr_yaml(grid).unwrap().text(),
            "aprilgrid:6x5:88mm:0.3"
        );
        let board = "target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n";
        assert_eq!(
            Target::from_kalibr_yaml(board).unwrap().text(),
            "chessboard:6x7:60mm"
        );
        let message = Target::from_kalibr_yaml("target_type: circlegrid")
            .unwrap_err()
            .to_string();
        assert!(message.contains("circlegrid is not known"), "{message}");
    }
}
