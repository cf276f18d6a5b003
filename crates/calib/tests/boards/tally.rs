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
            all.fair += part.fair;
            all.found += part.found;
            all.found_beyond += part.found_beyond;
            all.corners += part.corners;
            all.refused += part.refused;
            all.missed.extend(part.missed);
            all.wrong.extend(part.wrong);
        }
        all
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
                Case::Whole | Case::Blurred | Case::Dim | Case::Bent | Case::Mirrored
            );
        self.fair += usize::from(fair);
        match detect(&shot.picture, &asked) {
            Err(_) if fair => self.missed.push(name),
            Err(_) => self.refused += 1,
            Ok(_) if matches!(case, Case::Other | Case::Clutter) => {
                self.wrong
                    .push(format!("{name}: a board where there is none"));
            }
            Ok(found) => {
                let is_plain = matches!(asked, Target::Chessboard(_));
                let mirrored = case == Case::Mirrored;
                let mut truth = shot.truth.clone();
                if is_plain
                    && mirrored
                    && let Target::Chessboard(b) = asked
                {
                    // In a mirror a plain board is the same board, read from its other black corner.
                    let from_below = b.rows.is_multiple_of(2);
                    truth = (0..truth.len())
                        .map(|id| {
                            let (x, y) = (id % b.columns, id / b.columns);
                            let (x, y) = if from_below {
                                (x, b.rows - 1 - y)
                            } else {
                                (b.columns - 1 - x, y)
                            };
                            truth[y * b.columns + x]
                        })
                        .collect();
                }
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
