//! The 88 natural-scene features of DIIVINE (Moorthy and Bovik, "Blind Image Quality Assessment: From Natural Scene
//! Statistics to Perceptual Quality", IEEE Transactions on Image Processing, 2011), as the authors' release computes them,
//! its slips included.
//!
//! | features | what they are |
//! |---|---|
//! | f1 to f12 | variance of each normalised band |
//! | f13 to f24 | shape parameter of each normalised band |
//! | f25 to f31 | shape parameter of both scales of an orientation together, and of all twelve |
//! | f32 to f43 | contrast-structure similarity of each band with the high-pass residual |
//! | f44 to f73 | cubic through the spatial correlation of each normalised band of the first scale |
//! | f74 to f88 | contrast-structure similarity of the normalised bands of the first scale with each other |
//!
//! The pieces are public so that they can be measured and looked at one by one; [`plain`] is the slow reference.

pub mod correlation;
mod covariance;
pub mod enlarge;
mod kernels;
pub mod normalise;
pub mod plain;
pub mod pyramid;
pub mod shape;
pub mod structure;
mod tables;
mod windows;
mod workspace;

use pyramid::Pyramid;
use rayon::prelude::*;
use shape::Sums;
use tables::ORIENTATIONS;
use vergence_imaging::{Gray, Plane, Rgb};
use workspace::Workspace;

use crate::error::QualityError;

/// Number of features.
pub const FEATURE_COUNT: usize = 88;

/// f1 to f88 in order.
pub type Features = [f64; FEATURE_COUNT];

/// Shortest side of a picture: an 11 x 11 window must fit into a map that is smaller by 34.
pub const MIN_SIDE: usize = 45;

/// Shortest longer side: below it no pair of samples has the longest lag.
pub const MIN_LONGER_SIDE: usize = 60;

/// Lags of the spatial correlation in samples.
pub const LAGS: [usize; 7] = [1, 5, 9, 13, 17, 21, 25];

/// The features of a grey picture (values 0 to 255), on the threads of the current rayon pool; the same bytes on any
/// number of them.
///
/// Takes about 21 numbers of 8 bytes per pixel. Up to 2 GiB of it are kept for the next picture.
///
/// Errors: a picture smaller than [`MIN_SIDE`] on a side or [`MIN_LONGER_SIDE`] on both; one that is constant, or so nearly
/// that a band has nothing to be normalised by.
pub fn features_from_gray(picture: &Gray) -> Result<Features, QualityError> {
    // Refused before any memory is taken for it.
    check_size(picture.size())?;
    let samples = picture.samples();
    if samples.iter().all(|v| *v == samples[0]) {
        return Err(QualityError::Constant);
    }
    let mut memory = Workspace::kept();
    let mut plane = memory.plane(picture.width(), picture.height());
    let rows = picture.samples().par_chunks(picture.width());
    let out = plane.samples_mut().par_chunks_mut(picture.width());
    out.zip(rows).for_each(|(out, row)| {
        for (sample, &value) in out.iter_mut().zip(row) {
            *sample = f64::from(value);
        }
    });
    let features = features_in_memory(&plane, &mut memory);
    memory.take_back([plane]);
    memory.keep();
    features
}

/// [`features_from_gray`] of samples that are not rounded. The scale is that of 8-bit pictures, 0 to 255, and matters.
///
/// Errors: those of [`features_from_gray`], and a sample that is not a number.
pub fn features_from_plane(picture: &Plane<f64>) -> Result<Features, QualityError> {
    check(picture)?;
    let mut memory = Workspace::kept();
    let features = features_in_memory(picture, &mut memory);
    memory.keep();
    features
}

/// Grey of a colour picture as the release takes it: its weights, rounded to the nearest integer, halves up. (They are
/// not those of `vergence_imaging::colour`, from which this differs by up to one step.)
pub fn grey_from_rgb(picture: &Rgb) -> Gray {
    picture.map(|[r, g, b]| {
        let sum = 0.298936021293775 * f64::from(r)
            + 0.587043074451121 * f64::from(g)
            + 0.114020904255103 * f64::from(b);
        (sum + 0.5).floor().clamp(0.0, 255.0) as u8
    })
}

fn features_in_memory(
    picture: &Plane<f64>,
    memory: &mut Workspace,
) -> Result<Features, QualityError> {
    let pyramid = Pyramid::in_memory(picture, memory);
    let mut f = [0.0; FEATURE_COUNT];
    f[31..43].copy_from_slice(&structure::with_high(&pyramid.high, &pyramid.bands));
    let maps = normalise::in_memory(&pyramid.bands, memory)?;
    memory.take_back(pyramid.bands);
    memory.take_back([pyramid.high]);
    for (i, map) in maps.iter().enumerate() {
        f[i] = map.sums.variance();
        f[12 + i] = map.sums.shape();
    }
    for b in 0..ORIENTATIONS {
        f[24 + b] = maps[b].sums.pooled(maps[b + ORIENTATIONS].sums).shape();
    }
    let all = maps
        .iter()
        .fold(Sums::default(), |all, map| all.pooled(map.sums));
    f[30] = all.shape();
    for (out, map) in f[43..73].chunks_exact_mut(5).zip(&maps) {
        out.copy_from_slice(&correlation::cubic(&correlation::correlations(
            &map.map, map.range,
        )));
    }
    f[73..].copy_from_slice(&structure::among(std::array::from_fn(|m| &maps[m].map)));
    memory.take_back(maps.into_iter().map(|map| map.map));
    if f.iter().all(|v| v.is_finite()) {
        Ok(f)
    } else {
        Err(QualityError::Constant)
    }
}

fn check_size((width, height): (usize, usize)) -> Result<(), QualityError> {
    if width.min(height) < MIN_SIDE || width.max(height) < MIN_LONGER_SIDE {
        return Err(QualityError::TooSmall { width, height });
    }
    Ok(())
}

/// Large enough, finite, and not constant.
fn check(picture: &Plane<f64>) -> Result<(), QualityError> {
    check_size(picture.size())?;
    let samples = picture.samples();
    if samples.iter().any(|v| !v.is_finite()) {
        return Err(QualityError::NotANumber);
    }
    if samples.iter().all(|v| *v == samples[0]) {
        return Err(QualityError::Constant);
    }
    Ok(())
}

/// Names of f1 to f88. Bands 01 to 06 are the six orientations of the first scale, 07 to 12 of the second.
pub const FEATURE_NAMES: [&str; FEATURE_COUNT] = [
    "variance_01",
    "variance_02",
    "variance_03",
    "variance_04",
    "variance_05",
    "variance_06",
    "variance_07",
    "variance_08",
    "variance_09",
    "variance_10",
    "variance_11",
    "variance_12",
    "shape_01",
    "shape_02",
    "shape_03",
    "shape_04",
    "shape_05",
    "shape_06",
    "shape_07",
    "shape_08",
    "shape_09",
    "shape_10",
    "shape_11",
    "shape_12",
    "shape_pair_1",
    "shape_pair_2",
    "shape_pair_3",
    "shape_pair_4",
    "shape_pair_5",
    "shape_pair_6",
    "shape_all",
    "structure_01",
    "structure_02",
    "structure_03",
    "structure_04",
    "structure_05",
    "structure_06",
    "structure_07",
    "structure_08",
    "structure_09",
    "structure_10",
    "structure_11",
    "structure_12",
    "correlation_1_cubic",
    "correlation_1_square",
    "correlation_1_linear",
    "correlation_1_constant",
    "correlation_1_residual",
    "correlation_2_cubic",
    "correlation_2_square",
    "correlation_2_linear",
    "correlation_2_constant",
    "correlation_2_residual",
    "correlation_3_cubic",
    "correlation_3_square",
    "correlation_3_linear",
    "correlation_3_constant",
    "correlation_3_residual",
    "correlation_4_cubic",
    "correlation_4_square",
    "correlation_4_linear",
    "correlation_4_constant",
    "correlation_4_residual",
    "correlation_5_cubic",
    "correlation_5_square",
    "correlation_5_linear",
    "correlation_5_constant",
    "correlation_5_residual",
    "correlation_6_cubic",
    "correlation_6_square",
    "correlation_6_linear",
    "correlation_6_constant",
    "correlation_6_residual",
    "across_1_2",
    "across_1_3",
    "across_1_4",
    "across_1_5",
    "across_1_6",
    "across_2_3",
    "across_2_4",
    "across_2_5",
    "across_2_6",
    "across_3_4",
    "across_3_5",
    "across_3_6",
    "across_4_5",
    "across_4_6",
    "across_5_6",
];
