//! What several formats have in common: the 3x3 camera matrix and lists of distortion coefficients in OpenCV's order.

use vergence_geometry::{BrownConrady, Distortion, Intrinsics, KannalaBrandt};

/// Intrinsics of a camera matrix row by row, pixels.
pub(crate) fn intrinsics_from_rows(
    rows: &[[f64; 3]; 3],
    (width, height): (usize, usize),
) -> Result<Intrinsics, String> {
    let [[fx, skew, cx], [zero, fy, cy], last] = *rows;
    if skew != 0.0 || zero != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err(format!(
            "{rows:?} is not of the form [fx 0 cx, 0 fy cy, 0 0 1]"
        ));
    }
    Ok(Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    })
}

/// Brown–Conrady from OpenCV's order `k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 τx τy`, cut after the 4th, 5th, 8th, 12th or 14th.
pub(crate) fn brown_conrady(c: &[f64]) -> Result<Distortion, String> {
    if ![0, 4, 5, 8, 12, 14].contains(&c.len()) {
        return Err(format!(
            "{} distortion coefficients; there must be 0, 4, 5, 8, 12 or 14",
            c.len()
        ));
    }
    if let Some((i, v)) = c.iter().enumerate().skip(8).find(|(_, v)| **v != 0.0) {
        return Err(format!(
            "distortion coefficient {} is {v}; thin prism and tilted sensor terms (9th to 14th) are not supported and must \
             be 0",
            i + 1
        ));
    }
    let at = |i: usize| c.get(i).copied().unwrap_or(0.0);
    Ok(Distortion::from(BrownConrady {
        k1: at(0),
        k2: at(1),
        p1: at(2),
        p2: at(3),
        k3: at(4),
        k4: at(5),
        k5: at(6),
        k6: at(7),
    }))
}

/// Kannala–Brandt from its four coefficients.
pub(crate) fn kannala_brandt(c: &[f64]) -> Result<Distortion, String> {
    let &[k1, k2, k3, k4] = c else {
        return Err(format!(
            "{} distortion coefficients; a fisheye lens has 4",
            c.len()
        ));
    };
    Ok(KannalaBrandt { k1, k2, k3, k4 }.into())
}

/// The coefficients as OpenCV has them: 5 or, where the denominator is used, 8 of Brown–Conrady; 4 of Kannala–Brandt.
pub(crate) fn coefficients(lens: &Distortion) -> Vec<f64> {
    let mut c = lens.coefficients();
    if c.len() == 8 && c[5..] == [0.0; 3] {
        c.truncate(5);
    }
    c
}
