// What came of random pictures; shared by the test and the example.

/// What came of random pictures.
#[derive(Debug, Default)]
struct Tally {
    /// Pictures that any detector should manage: the whole board, not too bad.
    fair: usize,
    found: usize,
    /// Of all others, boards that were found all the same.
    found_beyond: usize,
    corners: usize,
    refused: usize,
    missed: Vec<String>,
    wrong: Vec<String>,
    /// Pictures of another board of which no more is seen than both boards have, and that was taken for the one asked for.
    fits_both: Vec<String>,
}

impl Tally {
    /// Pictures `from..to` on all processors; the order of the threads does not matter.
    fn of(
        pictures: std::ops::Range<u64>,
        what: impl Fn(u64) -> (&'static str, Case) + Sync,
    ) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from) as u64;
        let parts: Vec<Tally> = std::thread::scope(|scope| {
            let part = |k: u64| {
                let (pictures, what) = (pictures.clone(), &what);
                scope.spawn(move || {
                    let mut tally = Tally::default();
                    for seed in pictures.filter(|s| s % threads == k) {
                        let (text, case) = what(seed);
                        tally.add(text, case, seed);
                    }
                    tally
                })
            };
            let started: Vec<_> = (0..threads).map(part).collect();
            started
                .into_iter()
                .map(|t| t.join().expect("a picture panicked"))
                .collect()
        });
        let mut all = Tally::default();
        for part in parts {
            all.add_all(part);
        }
        all
    }

    fn add_all(&mut self, part: Tally) {
        self.fair += part.fair;
        self.found += part.found;
        self.found_beyond += part.found_beyond;
        self.corners += part.corners;
        self.refused += part.refused;
        self.missed.extend(part.missed);
        self.wrong.extend(part.wrong);
        self.fits_both.extend(part.fits_both);
    }

    /// The counts in one line.
    fn line(&self) -> String {
        format!(
            "{} fair, {} of them found, {} found beyond, {} refused, {} corners, {} wrong, {} of another board that fits",
            self.fair,
            self.found,
            self.found_beyond,
            self.refused,
            self.corners,
            self.wrong.len(),
            self.fits_both.len()
        )
    }

    fn add(&mut self, text: &str, case: Case, seed: u64) {
        let asked = target(text);
        let shown = match case {
            Case::Other => other_than(text, seed),
            _ => asked,
        };
        let shot = random_shot(&shown, case, seed);
        let name = format!("{text}, {case:?}, seed {seed}");
        let whole = shot.inside == shown.point_count();
        let fair = whole
            && matches!(
                case,
                Case::Whole
                    | Case::Blurred
                    | Case::Dim
                    | Case::Bent
                    | Case::Mirrored
                    | Case::Moving
                    | Case::Oblique
            );
        self.fair += usize::from(fair);
        match detect(&shot.picture, &asked) {
            Err(_) if fair => self.missed.push(name),
            Err(_) => self.refused += 1,
            Ok(_) if case == Case::Other && fits_both(&asked, &shown, &shot) => {
                self.fits_both.push(name);
            }
            Ok(_) if matches!(case, Case::Other | Case::Clutter) => {
                self.wrong
                    .push(format!("{name}: a board where there is none"));
            }
            Ok(found) => {
                let is_plain = matches!(asked, Target::Chessboard(_));
                let mirrored = case == Case::Mirrored;
                let truth = match asked {
                    Target::Chessboard(board) if mirrored => mirrored_truth(&board, &shot.truth),
                    _ => shot.truth.clone(),
                };
                let (worst, _) = errors(&found, &truth);
                if worst > 3.0 || found.mirrored != (mirrored && !is_plain) {
                    let off: Vec<String> = (found.corners.iter())
                        .filter(|c| truth[c.id].is_none_or(|t| (t - c.pixel).norm() > 3.0))
                        .take(4)
                        .map(|c| format!("{} at {:.0?} not {:.0?}", c.id, c.pixel, truth[c.id]))
                        .collect();
                    self.wrong.push(format!(
                        "{name}: off by {worst:.1} px, mirrored {}, {} corners: {off:?}",
                        found.mirrored,
                        found.corners.len()
                    ));
                }
                self.corners += found.corners.len();
                if fair {
                    self.found += 1;
                } else {
                    self.found_beyond += 1;
                }
            }
        }
    }
}

/// In a mirror a plain board is the same board, read from its other black corner.
fn mirrored_truth(
    board: &vergence_calib::target::Chessboard,
    truth: &[Option<nalgebra::Point2<f64>>],
) -> Vec<Option<nalgebra::Point2<f64>>> {
    let from_below = board.rows.is_multiple_of(2);
    let place = |id: usize| {
        let (x, y) = (id % board.columns, id / board.columns);
        match from_below {
            true => (x, board.rows - 1 - y),
            false => (board.columns - 1 - x, y),
        }
    };
    (0..truth.len())
        .map(|id| {
            let (x, y) = place(id);
            truth[y * board.columns + x]
        })
        .collect()
}

/// Whether the markers that lie in the picture, and all corners there, are also those of another board of the same dictionary, somewhere on it:
/// then nobody can tell the two. By the truth alone, whatever a detector sees.
fn fits_both(asked: &Target, shown: &Target, shot: &Shot) -> bool {
    let (Target::Charuco(asked), Target::Charuco(shown)) = (asked, shown) else {
        return false;
    };
    if asked.dictionary.cells() != shown.dictionary.cells() || asked.inverted != shown.inverted {
        return false;
    }
    let is_seen = |column: usize, row: usize| {
        let at = shot.truth[row * (shown.columns - 1) + column];
        at.is_some_and(|p| p.x >= 0.0 && p.y >= 0.0 && p.x < 640.0 && p.y < 480.0)
    };
    let seen: Vec<(usize, usize)> = (0..shown.rows - 1)
        .flat_map(|row| (0..shown.columns - 1).map(move |column| (column, row)))
        .filter(|&(column, row)| is_seen(column, row))
        .collect();
    let whole = |&(column, row): &(usize, usize)| {
        let own = |&(x, y): &(usize, usize)| {
            (x == column || x + 1 == column) && (y == row || y + 1 == row)
        };
        let count = seen.iter().filter(|corner| own(corner)).count();
        count >= 2
    };
    let markers: Vec<(usize, (usize, usize))> = (shown.marked_squares().enumerate())
        .filter(|(_, square)| whole(square))
        .collect();
    let homes: Vec<(usize, usize)> = asked.marked_squares().collect();
    let shift = |id: usize, square: (usize, usize)| {
        let home = homes.get(id)?;
        Some([
            home.0 as i64 - square.0 as i64,
            home.1 as i64 - square.1 as i64,
        ])
    };
    let Some(first) = markers.first().and_then(|&(id, square)| shift(id, square)) else {
        // Without a marker nothing of such a board is seen.
        return false;
    };
    let in_asked = |&(column, row): &(usize, usize)| {
        let (x, y) = (column as i64 + first[0], row as i64 + first[1]);
        (0..asked.columns as i64 - 1).contains(&x) && (0..asked.rows as i64 - 1).contains(&y)
    };
    markers
        .iter()
        .all(|&(id, square)| shift(id, square) == Some(first))
        && seen.iter().all(in_asked)
}

/// Another board than the one of a text.
fn other_than(text: &str, seed: u64) -> Target {
    let others = [
        "chessboard:8x5:25mm",
        "chessboard:10x7:25mm",
        "charuco:6x6:40mm:30mm:DICT_4X4_250",
        "charuco:9x7:40mm:30mm:DICT_7X7_100",
        "aprilgrid:4x5:50mm:0.25:first=100",
        "chessboard:7x7:30mm",
    ];
    let n = seed as usize;
    let all = || (0..others.len()).map(|i| others[(n + i) % others.len()]);
    let kind = text.split(':').next();
    // A plain board asked for is shown other plain boards most of the time.
    let same = all().find(|o| o.split(':').next() == kind);
    target(if n.is_multiple_of(3) {
        others[n / 3 % others.len()]
    } else {
        same.unwrap_or(others[0])
    })
}
