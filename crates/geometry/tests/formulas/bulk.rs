//! Proves that the bulk form gives the same bits compiled for vector units as by the plain loop, equals the careful
//! form of the cameras to 1e-15 m, and marks what is behind a camera. It times nothing.

use vergence_geometry::bulk::{Parallaxes, seen_depths};
use vergence_geometry::{Mode, Screen, StereoArray, Viewer};

/// Points on a lattice that covers front, edges and behind; lengths that are no multiple of any vector.
fn points() -> [Vec<f64>; 3] {
    let mut xyz = [vec![], vec![], vec![]];
    for i in 0..4003_u32 {
        // Three incommensurable steps.
        let step = |k: f64| (f64::from(i) * k).fract();
        xyz[0].push(6.0 * step(0.618_033_988_75) - 3.0);
        xyz[1].push(4.0 * step(0.754_877_666_25) - 2.0);
        xyz[2].push(12.0 * step(0.569_840_290_99) - 1.0);
    }
    xyz
}

#[test]
fn same_bits_as_the_plain_loop_and_same_numbers_as_the_cameras() {
    let [x, y, z] = points();
    let screen = Screen::default();
    for mode in [
        Mode::Parallel,
        Mode::Shifted { distance_m: 2.0 },
        Mode::Converged { distance_m: 2.0 },
        Mode::Verged {
            target_m: [0.7, 0.0, 1.1],
        },
    ] {
        for (count, pupil_m) in [(2, 0.0), (2, 0.09), (5, 0.03)] {
            let array = StereoArray {
                mode,
                count,
                pupil_m,
                ..StereoArray::default()
            };
            let views = array.views().unwrap();
            let left = count / 2;
            let left = left - 1 + usize::from(count > 2);
            let form = Parallaxes::new(&views, left, &screen).unwrap();
            let n = x.len();
            let (mut p, mut q) = (vec![0.0; n], vec![0.0; n]);
            let (mut p_plain, mut q_plain) = (vec![0.0; n], vec![0.0; n]);
            form.evaluate(&x, &y, &z, &mut p, &mut q).unwrap();
            form.evaluate_scalar(&x, &y, &z, &mut p_plain, &mut q_plain)
                .unwrap();
            let mut seen = 0;
            for i in 0..n {
                assert_eq!(p[i].to_bits(), p_plain[i].to_bits(), "{mode:?} {i}");
                assert_eq!(q[i].to_bits(), q_plain[i].to_bits(), "{mode:?} {i}");
                let point = [x[i], y[i], z[i]];
                let depth = [left, left + 1].map(|k| views.cameras()[k].depth_m(point));
                if depth[0].min(depth[1]).abs() < 1e-9 {
                    continue;
                }
                match views.difference_m(left, point) {
                    Some([dx, dy]) => {
                        // Relative to how much a point that near is magnified.
                        let near = depth[0].min(depth[1]);
                        let scale = 1e-14 * (1.0 + 1.0 / (near * near)) * (1.0 + x[i] * x[i]);
                        assert!((p[i] - 50.0 * dx).abs() < scale, "{mode:?} {point:?}");
                        assert!((q[i] - 50.0 * dy).abs() < scale, "{mode:?} {point:?}");
                        seen += 1;
                    }
                    None => assert!(p[i].is_nan() && q[i].is_nan(), "{mode:?} {point:?}"),
                }
            }
            assert!(seen > n / 2 && seen < n);
        }
    }
}

/// Arrays too large for the caches go another way inside; same bits, at odd starts and odd ends.
#[test]
fn streamed_results_are_the_same_bits() {
    let n = (1 << 21) + 37;
    let [x, y, z] = points();
    let many = |v: &[f64]| -> Vec<f64> { v.iter().copied().cycle().take(n + 3).collect() };
    let (x, y, z) = (many(&x), many(&y), many(&z));
    let array = StereoArray {
        mode: Mode::Converged { distance_m: 2.0 },
        ..StereoArray::default()
    };
    let form = Parallaxes::new(&array.views().unwrap(), 0, &Screen::default()).unwrap();
    let (mut p, mut q) = (vec![0.0; n + 3], vec![0.0; n + 3]);
    let (mut p_plain, mut q_plain) = (vec![0.0; n], vec![0.0; n]);
    for start in [0, 1, 3] {
        let range = start..start + n;
        let xyz = [&x, &y, &z].map(|v| &v[range.clone()]);
        form.evaluate(
            xyz[0],
            xyz[1],
            xyz[2],
            &mut p[range.clone()],
            &mut q[range.clone()],
        )
        .unwrap();
        form.evaluate_scalar(xyz[0], xyz[1], xyz[2], &mut p_plain, &mut q_plain)
            .unwrap();
        for (a, b) in [(&p[range.clone()], &p_plain[..]), (&q[range], &q_plain[..])] {
            assert!(
                a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits()),
                "{start}"
            );
        }
    }
}

#[test]
fn seen_depths_of_many() {
    let viewer = Viewer::default();
    let p = [-0.065, 0.0, 0.0325, 0.065, 0.07, f64::NAN];
    let mut z = [1.0; 6];
    seen_depths(&viewer, &p, &mut z).unwrap();
    assert!((z[0] - 0.35).abs() < 1e-15 && z[1] == 0.0 && (z[2] + 0.7).abs() < 1e-15);
    assert!(z[3..].iter().all(|v| v.is_nan()));
}

#[test]
fn unequal_slices_are_refused() {
    let views = StereoArray::default().views().unwrap();
    let form = Parallaxes::new(&views, 0, &Screen::default()).unwrap();
    let error = form
        .evaluate(
            &[0.0; 3],
            &[0.0; 3],
            &[1.0; 2],
            &mut [0.0; 3],
            &mut [0.0; 3],
        )
        .unwrap_err();
    assert_eq!(
        error.to_string(),
        "z holds 2 values, it must hold 3, as many as x"
    );
    assert!(Parallaxes::new(&views, 1, &Screen::default()).is_err());
}
