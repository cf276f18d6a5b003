//! The drawings of the report: where corners were seen and how far off, how well points are known, how ranges are.

use nalgebra::Point2;
use vergence_calib::solve::Calibration;

use super::Work;
use super::answer;
use crate::figure::Figure;
use crate::figure::axis::Axis;
use crate::figure::canvas::{Canvas, Paint, Type};
use crate::figure::colour::{GREY, INK, LINES, PALE};
use crate::figure::lines::{Panel, Series, Stack, Stroke};
use crate::figure::map::{Atlas, Map};

/// Width of a picture in the drawings, units.
const WIDE: f64 = 420.0;

/// Arrows show errors so many times as large as they are.
const ENLARGED: f64 = 60.0;

/// Corners of every camera in its picture, each with its error as an arrow: gaps and patterns are what to look for.
pub(super) fn coverage(work: &Work<'_>, found: &Calibration) -> Figure {
    let tall = |camera: usize| {
        let (w, h) = work.sizes[camera];
        WIDE * h as f64 / w as f64
    };
    let cameras = work.names.len();
    let columns = cameras.min(2);
    let rows = cameras.div_ceil(columns);
    let highest = (0..cameras).map(tall).fold(0.0, f64::max);
    let (width, height) = (
        30.0 + columns as f64 * (WIDE + 30.0),
        80.0 + rows as f64 * (highest + 46.0),
    );
    let mut canvas = Canvas::new(width, height);
    canvas.text(
        (20.0, 26.0),
        "Where corners were seen",
        &Type::size(15.0).bold(),
    );
    canvas.text(
        (20.0, 46.0),
        &format!(
            "arrows: from the corner to where the calibration puts it, {ENLARGED:.0} times as long"
        ),
        &Type::size(11.0).colour(GREY),
    );
    for camera in 0..cameras {
        let corner = (
            30.0 + (camera % columns) as f64 * (WIDE + 30.0),
            84.0 + (camera / columns) as f64 * (highest + 46.0),
        );
        canvas.text(
            (corner.0, corner.1 - 8.0),
            &work.names[camera],
            &Type::size(12.0).bold(),
        );
        canvas.rect(
            corner,
            (WIDE, tall(camera)),
            &Paint {
                fill: Some(PALE),
                stroke: Some(INK),
                width: 1.0,
                ..Paint::default()
            },
        );
        let scale = WIDE / work.sizes[camera].0 as f64;
        canvas.clipped(corner, (WIDE, tall(camera)), |canvas| {
            for (seen, put) in errors(work, found, camera) {
                let place = |p: Point2<f64>| {
                    (
                        corner.0 + (p.x + 0.5) * scale,
                        corner.1 + (p.y + 0.5) * scale,
                    )
                };
                let tip = seen + (put - seen) * ENLARGED / scale.max(1e-6) * scale;
                canvas.line(place(seen), place(tip), &Paint::line(LINES[1], 0.8));
                canvas.circle(place(seen), 1.1, &Paint::area(LINES[0]));
            }
        });
    }
    canvas.finish(
        "Where corners were seen",
        "Corners in the pictures with enlarged errors",
    )
}

/// Corners of a camera's used shots: seen at, and put at by the calibration.
fn errors(work: &Work<'_>, found: &Calibration, camera: usize) -> Vec<(Point2<f64>, Point2<f64>)> {
    let mut all = Vec::new();
    for (shot, rms) in work.shots.iter().zip(&found.shot_rms_px) {
        let (true, Some(_), Some(cam_from_board)) =
            (shot.camera == camera, rms, found.cam_from_board(shot))
        else {
            continue;
        };
        for s in &shot.sightings {
            let put = found.cameras[camera].project(&(cam_from_board * s.point_in_board));
            all.extend(put.map(|put| (s.pixel, put)));
        }
    }
    all
}

/// RMS error of every picture, by camera.
pub(super) fn residuals(work: &Work<'_>, found: &Calibration) -> Figure {
    let series = work.names.iter().enumerate().map(|(camera, name)| {
        let own = work
            .shots
            .iter()
            .zip(&found.shot_rms_px)
            .filter(|(s, _)| s.camera == camera);
        let points = own
            .enumerate()
            .filter_map(|(i, (_, rms))| Some((i as f64 + 1.0, (*rms)?)))
            .collect();
        Series::new(name, points).stroke(Stroke::Points)
    });
    let series: Vec<Series> = series.collect();
    let most = series.iter().map(|s| s.points.len()).max().unwrap_or(1);
    let values = series.iter().flat_map(|s| s.points.iter().map(|p| p.1));
    let panel = Panel::new(Axis::around("RMS error, px", values, &[0.0]), series);
    Stack::new(
        "Error of every picture",
        "RMS distance of its corners from where the calibration puts them",
        Axis::linear("picture", 0.0, most as f64 + 1.0),
        vec![panel],
    )
    .draw()
}

/// Uncertainty of projections over each camera's picture, at the boards' distance and ten times as far.
pub(super) fn projection_maps(work: &Work<'_>, found: &Calibration) -> Vec<Figure> {
    (0..work.names.len())
        .filter_map(|camera| {
            let (w, h) = work.sizes[camera];
            let distances = answer::distances_m(work, found, camera);
            let coarse: Vec<Coarse> = distances
                .iter()
                .map(|d| Coarse::new(work, found, camera, *d))
                .collect::<Option<_>>()?;
            let largest = coarse.iter().flat_map(|c| &c.values).copied().fold(0.0, f64::max);
            let functions: Vec<Box<dyn Fn(f64, f64) -> f64>> = coarse
                .into_iter()
                .map(|c| Box::new(move |u, v| c.at(u, v)) as Box<dyn Fn(f64, f64) -> f64>)
                .collect();
            let maps = functions.iter().zip(&distances).map(|(value, d)| Map {
                title: format!("point at {d:.2} m"),
                value: &**value,
            });
            let value = Axis::linear("px", 0.0, largest);
            let atlas = Atlas {
                title: format!("How well camera {} knows where it sees a point", work.names[camera]),
                subtitle: "standard deviation of the projection by the calibration alone, along the axis where it is largest; where it grows no board was held"
                    .to_owned(),
                x: Axis::linear("u, px", 0.0, w as f64),
                y: Axis::linear("v, px", 0.0, h as f64),
                y_down: true,
                contours: value.ticks(6).into_iter().map(|(v, _)| v).filter(|v| *v > 0.0).collect(),
                value,
                maps: maps.collect(),
                columns: 2,
            };
            Some(atlas.draw())
        })
        .collect()
}

/// A map's values on a coarse grid, with straight lines between: each costs a sum over all boards.
struct Coarse {
    size: (f64, f64),
    values: Vec<f64>,
}

const GRID: usize = 25;

impl Coarse {
    fn new(work: &Work<'_>, found: &Calibration, camera: usize, distance_m: f64) -> Option<Self> {
        let (w, h) = work.sizes[camera];
        let size = (w as f64 - 1.0, h as f64 - 1.0);
        let values = (0..GRID * GRID)
            .map(|i| {
                let share = |n: usize| n as f64 / (GRID - 1) as f64;
                let pixel = Point2::new(share(i % GRID) * size.0, share(i / GRID) * size.1);
                answer::projection_px(work, found, camera, &pixel, distance_m).unwrap_or(f64::NAN)
            })
            .collect::<Vec<_>>();
        values
            .iter()
            .any(|v| v.is_finite())
            .then_some(Self { size, values })
    }

    fn at(&self, u: f64, v: f64) -> f64 {
        let place = |value: f64, side: f64| (value / side).clamp(0.0, 1.0) * (GRID - 1) as f64;
        let (x, y) = (place(u, self.size.0), place(v, self.size.1));
        let (i, j) = ((x as usize).min(GRID - 2), (y as usize).min(GRID - 2));
        let (fx, fy) = (x - i as f64, y - j as f64);
        let value = |i: usize, j: usize| self.values[j * GRID + i];
        (value(i, j) * (1.0 - fx) + value(i + 1, j) * fx) * (1.0 - fy)
            + (value(i, j + 1) * (1.0 - fx) + value(i + 1, j + 1) * fx) * fy
    }
}

/// Uncertainty of a pair's ranges; `None` for one camera.
pub(super) fn ranges(found: &Calibration) -> Option<Figure> {
    if found.cameras.len() < 2 {
        return None;
    }
    let records: Vec<_> = (0..60)
        .filter_map(|i| answer::range_at(found, 0.4 * 1.06_f64.powi(i)))
        .collect();
    let series = |name: &str, value: &dyn Fn(&answer::RangeRecord) -> f64| {
        let points = records
            .iter()
            .map(|r| (r.range_m, 1e3 * value(r)))
            .collect();
        Series::new(name, points)
    };
    let both = vec![
        series("by the calibration", &|r| r.calibration_m),
        series("by matching to a quarter pixel", &|r| r.matching_m),
    ];
    let values: Vec<f64> = both
        .iter()
        .flat_map(|s| s.points.iter().map(|p| p.1))
        .collect();
    let least = values
        .iter()
        .copied()
        .filter(|v| *v > 0.0)
        .fold(f64::MAX, f64::min);
    let most = values.iter().copied().fold(0.0, f64::max);
    let last = records.last().map_or(10.0, |r| r.range_m);
    let panel = Panel::new(Axis::log("standard deviation, mm", least, most), both);
    let plot = Stack::new(
        "How well ranges are known",
        "of a point straight ahead, at home; matching errors differ from point to point, the calibration's is the same for all",
        Axis::log("range, m", 0.4, last),
        vec![panel],
    );
    Some(plot.draw())
}
