//! The machine's file: round trip to the last digit, its poses those of what was solved, faults told.

use crate::views::{camera, head, head_shots};
use nalgebra::Isometry3;
use vergence_calib::MachineCalibration;
use vergence_calib::solve::{LensModel, Mechanism, MotorState, Settings, calibrate_head};
use vergence_geometry::Eye;

fn solved() -> (MachineCalibration, Mechanism) {
    let lenses = [
        camera(LensModel::BrownConrady5),
        camera(LensModel::BrownConrady5),
    ];
    let shots = head_shots(&head(), &lenses, 6, 6, 0.1, 3);
    let settings = Settings::new(LensModel::BrownConrady5, &[(1024, 768); 2]);
    let found = calibrate_head(&shots, &settings, [1.7e-4; 4]).unwrap();
    let names = ["left".to_owned(), "right".to_owned()];
    (
        MachineCalibration::from_solved(&found, names).unwrap(),
        found.mechanism,
    )
}

fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    a.rotation.angle_to(&b.rotation) + (a.translation.vector - b.translation.vector).norm()
}

/// The file gives back the same machine; its cameras stand against each other as the solved mechanism says, at any state; in its base frame
/// the lenses at home differ along x alone, about the origin.
#[test]
fn the_file_is_the_machine() {
    let (machine, mechanism) = solved();
    let back = MachineCalibration::parse(&machine.to_toml().unwrap()).unwrap();
    assert_eq!(back.cameras, machine.cameras);
    assert_eq!(back.names, machine.names);
    assert_eq!(back.sigmas.len(), machine.sigmas.len());
    for steps in [[0.0; 4], [200.0, -100.0, 300.0, -250.0]] {
        let motors = MotorState {
            steps,
            approach: [1.0, -1.0, 1.0, -1.0],
        };
        let [left, right] = Eye::BOTH.map(|eye| machine.base_from_cam(eye, &motors));
        let expected =
            mechanism.rig_from_cam(0, &motors).inverse() * mechanism.rig_from_cam(1, &motors);
        assert!(apart(&(left.inverse() * right), &expected) < 1e-12);
        for eye in Eye::BOTH {
            let off = apart(
                &back.base_from_cam(eye, &motors),
                &machine.base_from_cam(eye, &motors),
            );
            assert!(off < 1e-12, "{off}");
        }
        let rig = machine.at(&motors).unwrap();
        let between = expected.translation.vector.norm();
        assert!((rig.interaxial_m() - between).abs() < 1e-12);
    }
    // Small turns hardly tell where an axis is: its own uncertainty is the measure.
    let sigma = |name: &str| machine.sigmas.iter().find(|(n, _)| n == name).unwrap().1;
    let pivots = ["left.point_1_m", "right.point_1_m"];
    let pivots_sigma_m: f64 = pivots.iter().map(|n| sigma(n)).sum();
    let off = (machine.interaxial_m() - 0.0697).abs();
    assert!(
        pivots_sigma_m < 2e-3 && off < 4.0 * pivots_sigma_m,
        "{off} m of {pivots_sigma_m} m"
    );
    let apart = machine.home[1].translation.vector - machine.home[0].translation.vector;
    assert!(apart.y.abs() < 1e-12 && apart.z.abs() < 1e-12, "{apart}");
    let sum = machine.home[0].translation.vector + machine.home[1].translation.vector;
    assert!(
        sum.x.abs() < 4.0 * pivots_sigma_m && sum.y.abs() < 2e-3,
        "{sum}"
    );
}

/// Every fault of a file is one sentence that names the place.
#[test]
fn faults_are_told() {
    let text = solved().0.to_toml().unwrap();
    for (from, to, expected) in [
        ("version = 1", "version = 2", "version = 2"),
        (
            "format = \"vergence-machine\"",
            "format = \"other\"",
            "other",
        ),
        (
            "rad_per_step = 0.0001",
            "rad_per_step = -0.0001",
            "axis pan: rad_per_step",
        ),
        ("[axes.tilt]", "[axes.roll]", "roll"),
        ("fx_px = 13", "fx_px = -13", "focal"),
    ] {
        let broken = text.replacen(from, to, 1);
        assert_ne!(broken, text, "{from}");
        let error = MachineCalibration::parse(&broken).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(MachineCalibration::is_one(&text));
    assert!(!MachineCalibration::is_one("format = \"vergence-rig\""));
}
