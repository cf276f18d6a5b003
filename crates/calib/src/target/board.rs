//! What is printed on a target: points and rectangles in the board frame.

use nalgebra::Point3;

use super::{AprilGrid, Charuco, Chessboard, Dictionary, Target};

/// A uniform axis-aligned area of a board, metres in the board frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Left and upper border.
    pub min_m: [f64; 2],
    /// Right and lower border.
    pub max_m: [f64; 2],
    /// White, else black.
    pub white: bool,
}

impl Target {
    /// How many corners the target has; their numbers are below it.
    pub fn point_count(&self) -> usize {
        match self {
            Target::Chessboard(b) => b.columns * b.rows,
            Target::Charuco(b) => (b.columns - 1) * (b.rows - 1),
            Target::AprilGrid(b) => 4 * b.columns * b.rows,
        }
    }

    /// Where corner `id` is on the board, metres in the board frame (z is 0).
    ///
    /// # Panics
    /// When `id` is not below [`Self::point_count`].
    pub fn point_in_board(&self, id: usize) -> Point3<f64> {
        assert!(
            id < self.point_count(),
            "corner {id} of a target with {}",
            self.point_count()
        );
        let on_grid = |columns: usize, side_m: f64| {
            Point3::new(
                (id % columns) as f64 * side_m,
                (id / columns) as f64 * side_m,
                0.0,
            )
        };
        match self {
            Target::Chessboard(b) => on_grid(b.columns, b.square_m),
            Target::Charuco(b) => on_grid(b.columns - 1, b.square_m),
            Target::AprilGrid(b) => {
                let [left, bottom] = b.lower_left_m(id / 4);
                let (dx, dy) = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)][id % 4];
                Point3::new(left + dx * b.tag_m, bottom - dy * b.tag_m, 0.0)
            }
        }
    }

    /// The whole print as rectangles in painting order: a later one covers an earlier one. The first is the white (or, of an
    /// inverted board, black) sheet with a margin of one square, or of the width of a gap.
    pub fn rectangles(&self) -> Vec<Rectangle> {
        match self {
            Target::Chessboard(b) => b.rectangles(),
            Target::Charuco(b) => b.rectangles(),
            Target::AprilGrid(b) => b.rectangles(),
        }
    }
}

fn square(x: f64, y: f64, side: f64, white: bool) -> Rectangle {
    Rectangle {
        min_m: [x, y],
        max_m: [x + side, y + side],
        white,
    }
}

fn sheet(min_m: [f64; 2], max_m: [f64; 2], margin_m: f64) -> Rectangle {
    Rectangle {
        min_m: min_m.map(|v| v - margin_m),
        max_m: max_m.map(|v| v + margin_m),
        white: true,
    }
}

impl Chessboard {
    fn rectangles(&self) -> Vec<Rectangle> {
        let s = self.square_m;
        let far = |n: usize| n as f64 * s;
        let mut all = vec![sheet([-s, -s], [far(self.columns), far(self.rows)], s)];
        for row in 0..=self.rows {
            for column in (row % 2..=self.columns).step_by(2) {
                all.push(square(far(column) - s, far(row) - s, s, false));
            }
        }
        all
    }
}

impl Charuco {
    /// Whether a square is white and holds a marker.
    pub(crate) fn is_marked(&self, column: usize, row: usize) -> bool {
        let shift = usize::from(self.legacy && self.rows.is_multiple_of(2));
        (column + row + shift) % 2 == 1
    }

    /// Marked squares, (column, row) from the top left one, in the order of their markers' numbers.
    pub fn marked_squares(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        (0..self.rows)
            .flat_map(|row| (0..self.columns).map(move |column| (column, row)))
            .filter(|&(column, row)| self.is_marked(column, row))
    }

    fn rectangles(&self) -> Vec<Rectangle> {
        let s = self.square_m;
        let edge = |n: usize| (n as f64 - 1.0) * s;
        let mut all = vec![sheet([-s, -s], [edge(self.columns), edge(self.rows)], s)];
        for row in 0..self.rows {
            for column in (0..self.columns).filter(|&c| !self.is_marked(c, row)) {
                all.push(square(edge(column), edge(row), s, false));
            }
        }
        let margin = (s - self.marker_m) / 2.0;
        for (marker, (column, row)) in self.marked_squares().enumerate() {
            let at = [edge(column) + margin, edge(row) + margin];
            let upright = |c, r| !self.dictionary.is_black(marker, c, r);
            push_marker(&mut all, at, self.marker_m, self.dictionary, 1, upright);
        }
        if self.inverted {
            for r in &mut all {
                r.white = !r.white;
            }
        }
        all
    }
}

/// A marker's black square with its white cells.
fn push_marker(
    all: &mut Vec<Rectangle>,
    at_m: [f64; 2],
    side_m: f64,
    dictionary: Dictionary,
    border: usize,
    is_white: impl Fn(usize, usize) -> bool,
) {
    let n = dictionary.cells();
    let cell = side_m / (n + 2 * border) as f64;
    all.push(square(at_m[0], at_m[1], side_m, false));
    let place = |from: f64, i: usize| from + (i + border) as f64 * cell;
    for row in 0..n {
        for column in (0..n).filter(|&c| is_white(c, row)) {
            // Both borders by the same formula, so that neighbours share theirs to the last bit.
            all.push(Rectangle {
                min_m: [place(at_m[0], column), place(at_m[1], row)],
                max_m: [place(at_m[0], column + 1), place(at_m[1], row + 1)],
                white: true,
            });
        }
    }
}

impl AprilGrid {
    /// Lower left corner of a tag, counted from the first.
    fn lower_left_m(&self, tag: usize) -> [f64; 2] {
        let pitch = self.tag_m * (1.0 + self.spacing);
        [
            (tag % self.columns) as f64 * pitch,
            -((tag / self.columns) as f64 * pitch),
        ]
    }

    fn rectangles(&self) -> Vec<Rectangle> {
        let (t, gap) = (self.tag_m, self.tag_m * self.spacing);
        let pitch = t + gap;
        let extent = |n: usize| n as f64 * pitch;
        // The squares between the tags' corners belong to the pattern.
        let (left, right) = (-gap, extent(self.columns));
        let (top, bottom) = (-extent(self.rows), gap);
        let mut all = vec![sheet([left, top], [right, bottom], gap)];
        for row in 0..=self.rows {
            for column in 0..=self.columns {
                all.push(square(extent(column) - gap, -extent(row), gap, false));
            }
        }
        let dictionary = Dictionary::tag36h11();
        let last = dictionary.cells() - 1;
        for tag in 0..self.columns * self.rows {
            let [x, y] = self.lower_left_m(tag);
            let upright =
                |c: usize, r: usize| !dictionary.is_black(self.first_id + tag, last - c, last - r);
            push_marker(&mut all, [x, y - t], t, dictionary, self.border, upright);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGETS: [&str; 6] = [
        "chessboard:9x6:25mm",
        "charuco:5x7:40mm:20mm:DICT_6X6_250",
        "charuco:4x6:40mm:20mm:DICT_4X4_50:legacy",
        "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
        "aprilgrid:6x4:88mm:0.3",
        "aprilgrid:2x3:88mm:0.25:first=5:border=1",
    ];

    /// Colour of the print at a place.
    fn is_white(all: &[Rectangle], x: f64, y: f64) -> bool {
        let covers =
            |r: &&Rectangle| x >= r.min_m[0] && x < r.max_m[0] && y >= r.min_m[1] && y < r.max_m[1];
        all.iter().rfind(covers).unwrap().white
    }

    /// At every corner of every target black and white meet crosswise: the points and the print are one board. Corner 0 is the
    /// origin.
    #[test]
    fn corners_are_where_the_print_has_them() {
        for text in TARGETS {
            let target = Target::parse(text).unwrap();
            let all = target.rectangles();
            assert_eq!(target.point_in_board(0), Point3::origin());
            for id in 0..target.point_count() {
                let p = target.point_in_board(id);
                let d = 1e-3;
                let at = |dx: f64, dy: f64| is_white(&all, p.x + dx * d, p.y + dy * d);
                let (a, b) = (at(1.0, 1.0), at(-1.0, 1.0));
                assert!(a != b, "{text} {id}");
                assert_eq!([at(-1.0, -1.0), at(1.0, -1.0)], [a, b], "{text} {id}");
            }
        }
    }

    /// Markers of OpenCV's layouts: the square that marker 0 is in, and a cell of it (drawn by OpenCV 5.0).
    #[test]
    fn markers_are_where_opencv_has_them() {
        let squares = |text: &str| match Target::parse(text).unwrap() {
            Target::Charuco(b) => b.marked_squares().collect::<Vec<_>>(),
            _ => Vec::new(),
        };
        assert_eq!(squares(TARGETS[1])[..3], [(1, 0), (3, 0), (0, 1)]);
        assert_eq!(squares(TARGETS[2])[..3], [(0, 0), (2, 0), (1, 1)]);
        // With an odd number of rows both layouts are the same.
        assert_eq!(
            squares("charuco:5x7:40mm:20mm:DICT_6X6_250:legacy"),
            squares(TARGETS[1])
        );
    }

    /// The drawing to print has the pattern's size in millimetres and one rectangle for each of the print's.
    #[test]
    fn svg_is_to_scale() {
        let target = Target::parse("chessboard:9x6:25mm").unwrap();
        let svg = target.svg();
        assert!(svg.contains("width=\"300mm\""), "{svg}");
        assert_eq!(svg.matches("fill=\"#000\"/>").count(), 35);
        assert!(svg.contains("chessboard:9x6:25mm"));
        assert!(svg.contains("100 mm"));
    }
}
