//! Dictionaries of markers: bit tables by other people, taken from the crate `calib-targets-aruco`.

use calib_targets_aruco::builtins;

/// A dictionary of square markers, by OpenCV's name (`DICT_4X4_50` ... `DICT_7X7_1000`, `DICT_ARUCO_ORIGINAL`,
/// `DICT_APRILTAG_36h11`, ...).
#[derive(Clone, Copy, Debug)]
pub struct Dictionary(calib_targets_aruco::Dictionary);

impl PartialEq for Dictionary {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Dictionary {}

impl Dictionary {
    /// The dictionary of a name; letters of either case. `None` when there is none.
    pub fn named(name: &str) -> Option<Self> {
        builtins::BUILTIN_DICTIONARY_NAMES
            .iter()
            .find(|known| known.eq_ignore_ascii_case(name))
            .and_then(|known| builtins::builtin_dictionary(known))
            .map(Self)
    }

    /// All names, sorted.
    pub fn names() -> &'static [&'static str] {
        builtins::BUILTIN_DICTIONARY_NAMES
    }

    /// The tags of an AprilGrid: family 36h11, 587 tags.
    pub(crate) fn tag36h11() -> Self {
        Self(builtins::DICT_APRILTAG_36h11)
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.0.name()
    }

    /// Cells along a marker's side, without the border.
    pub fn cells(&self) -> usize {
        self.0.marker_size()
    }

    /// How many markers there are.
    pub fn count(&self) -> usize {
        self.0.codes().len()
    }

    /// Whether a cell of an upright marker is black. Columns run right, rows down, both from 0 inside the border.
    pub fn is_black(&self, marker: usize, column: usize, row: usize) -> bool {
        // Row by row from the lowest bit.
        self.0.codes()[marker] >> (row * self.cells() + column) & 1 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells of markers as OpenCV 5.0 draws them (`generateImageMarker`), `#` for black: another source than the crate that we take.
    #[test]
    fn markers_are_those_of_opencv() {
        let drawn = [
            ("DICT_4X4_50", 7, "..## #.## .... ##.#"),
            ("DICT_5X5_100", 42, "#..#. .#### .##.# #.... .#..."),
            (
                "DICT_6X6_250",
                123,
                ".#..## ####.. #.#.## #..... .##... .#...#",
            ),
            (
                "DICT_APRILTAG_36h11",
                35,
                "#.#.#. ###### ####.. .#.#.. #..### #.#..#",
            ),
            ("DICT_ARUCO_ORIGINAL", 5, ".#### .#### .#### .#... .#..."),
            (
                "dict_7x7_1000",
                999,
                "...##.. ....##. .#.##.# ..#...# ##.#### ##..#.# #......",
            ),
        ];
        for (name, marker, rows) in drawn {
            let dictionary = Dictionary::named(name).unwrap();
            assert!(dictionary.name().eq_ignore_ascii_case(name));
            for (row, cells) in rows.split(' ').enumerate() {
                for (column, cell) in cells.chars().enumerate() {
                    assert_eq!(
                        dictionary.is_black(marker, column, row),
                        cell == '#',
                        "{name} {marker}: {column}, {row}"
                    );
                }
            }
        }
        assert_eq!(Dictionary::tag36h11().count(), 587);
        assert!(Dictionary::named("DICT_4X4").is_none());
    }
}
