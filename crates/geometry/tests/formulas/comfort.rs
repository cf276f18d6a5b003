//! Proves that each rule's limits in parallax are the same statement as its bands in its own unit (the verdict changes
//! exactly there), that the numbers of the sources come out, and that every rule is listed once with its source. It
//! does not prove that any rule is true of people.

use vergence_geometry::Viewer;
use vergence_geometry::comfort::{
    AngularDisparity, Band, Basis, Front, Orthostereo, PuppetTheatre, Roundness, Rule, SeenDepth,
    Shibata, VerticalParallax, Viewing, WindowViolation, floating_window,
};

/// The paper's rig on a 1/3 inch sensor, M = 50.
const NEAR: Viewing = Viewing {
    viewer: Viewer {
        interocular_m: 0.065,
        distance_m: 0.7,
    },
    screen_width_m: 0.24,
    width_px: 1024,
};
/// A television.
const FAR: Viewing = Viewing {
    viewer: Viewer {
        interocular_m: 0.063,
        distance_m: 3.0,
    },
    screen_width_m: 1.2,
    width_px: 1920,
};

/// A verdict just inside each limit and just outside: the limits in metres and the bands in the unit agree.
#[test]
fn limits_in_parallax_are_the_bands() {
    for viewing in [NEAR, FAR] {
        let mut judged = 0;
        for rule in Rule::all() {
            let Some(limits) = rule.parallax_limits(&viewing) else {
                assert_eq!(rule.verdict_for_parallax(0.001, &viewing), None);
                continue;
            };
            judged += 1;
            let id = rule.info().id;
            let band = |p: f64| rule.verdict_for_parallax(p, &viewing).unwrap().band;
            assert!(band(0.0) <= Band::Comfortable, "{id}");
            assert!(
                limits.front_acceptable_m <= limits.front_comfortable_m
                    && limits.front_comfortable_m <= 0.0
                    && limits.behind_comfortable_m >= 0.0
                    && limits.behind_comfortable_m <= limits.behind_acceptable_m,
                "{id} {limits:?}"
            );
            for (limit, inside, outside) in [
                (limits.front_acceptable_m, Band::Acceptable, Band::Excessive),
                (
                    limits.behind_acceptable_m,
                    Band::Acceptable,
                    Band::Excessive,
                ),
                (
                    limits.front_comfortable_m,
                    Band::Comfortable,
                    Band::Acceptable,
                ),
                (
                    limits.behind_comfortable_m,
                    Band::Comfortable,
                    Band::Acceptable,
                ),
            ] {
                if !limit.is_finite() {
                    continue;
                }
                assert!(band(limit * (1.0 - 1e-9)) <= inside, "{id} inside {limit}");
                assert!(
                    band(limit * (1.0 + 1e-9)) >= outside,
                    "{id} outside {limit}"
                );
            }
            if let Some([front, behind]) = limits.no_depth_m {
                for limit in [front, behind] {
                    assert_eq!(band(limit * (1.0 - 1e-9)), Band::NoDepth);
                    assert_eq!(band(limit * (1.0 + 1e-9)), Band::Comfortable);
                }
            }
        }
        assert_eq!(judged, 10);
    }
}

/// Every rule is listed once, found by its id, and says where it comes from.
#[test]
fn rules_are_listed_with_their_sources() {
    let ids: Vec<_> = Rule::all().iter().map(|rule| rule.info().id).collect();
    for id in &ids {
        assert_eq!(ids.iter().filter(|other| *other == id).count(), 1, "{id}");
        let info = Rule::by_id(id).unwrap().info();
        assert!(!info.source.is_empty() && !info.quantity.is_empty() && !info.limits.is_empty());
        // A constant from second hand, fitted or chosen by the project is never called read.
        let basis = if info.source.contains("unconfirmed") && info.basis != Basis::Design {
            Basis::Unconfirmed
        } else if info.source.contains("design value") {
            Basis::Design
        } else if info.source.contains("fitted") {
            Basis::Fitted
        } else {
            Basis::Read
        };
        assert_eq!(info.basis, basis, "{id}");
        // The sign that is stated is the sign that is measured.
        let sign = match info.front {
            Front::Positive => Some(1.0),
            Front::Negative => Some(-1.0),
            Front::Neither => None,
        };
        let measured = Rule::by_id(id).unwrap().measure_parallax(-0.001, &NEAR);
        assert_eq!(measured.map(f64::signum), sign, "{id}");
    }
    assert_eq!(ids[0], Rule::default().info().id);
    assert!(Rule::by_id("no-such-rule").is_none());
}

/// Seen depth: the fractions put the point where they say, and the parallaxes are the hand-computed ones.
#[test]
fn seen_depth_by_hand() {
    assert!((SeenDepth::parallax_m(0.10, &NEAR) + 0.0065 / 0.9).abs() < 1e-15);
    assert!((SeenDepth::parallax_m(-0.05, &NEAR) - 0.00325 / 1.05).abs() < 1e-15);
    for q in [-0.5, -0.1, 0.05, 0.3] {
        let d = NEAR
            .viewer
            .seen_distance_m(SeenDepth::parallax_m(q, &NEAR))
            .unwrap();
        assert!((d - 0.7 * (1.0 - q)).abs() < 1e-14, "{q} {d}");
    }
    let beyond = Rule::default().verdict_for_parallax(0.07, &NEAR).unwrap();
    assert_eq!(beyond.band, Band::Excessive);
}

/// Angular disparity against the definition by two arctangents, and its inverse.
#[test]
fn angular_disparity_by_definition() {
    for viewing in [NEAR, FAR] {
        let (e, v) = (viewing.viewer.interocular_m, viewing.viewer.distance_m);
        for p in [-0.5 * e, -0.1 * e, 0.0, 0.3 * e, 0.99 * e] {
            let d = v * e / (e - p);
            let eta = 2.0 * (e / (2.0 * d)).atan() - 2.0 * (e / (2.0 * v)).atan();
            let rule = Rule::AngularDisparity(AngularDisparity::ONE_DEGREE);
            let ours = rule.measure_parallax(p, &viewing).unwrap();
            assert!((ours - eta.to_degrees() * 60.0).abs() < 1e-9, "{p}");
            assert!((AngularDisparity::parallax_m(ours, &viewing) - p).abs() < 1e-14);
        }
        // More uncrossed disparity than the screen's own vergence cannot be had without divergence.
        assert_eq!(
            AngularDisparity::parallax_m(-400.0, &viewing),
            f64::INFINITY
        );
    }
    // The project's table: parallel, 1 m: 22.75 mm crossed is 111.4 arc minutes to first order, p / V.
    let small = Rule::by_id("arcmin-1-degree")
        .unwrap()
        .measure_parallax(-1e-6, &NEAR)
        .unwrap();
    assert!((small / (1e-6_f64 / 0.7).to_degrees() / 60.0 - 1.0).abs() < 0.005);
}

/// Shibata's zone from its two lines, and infinity allowed when the far line says so.
#[test]
fn zone_of_comfort_from_its_lines() {
    let zone = Rule::Shibata(Shibata);
    let limits = zone.parallax_limits(&NEAR).unwrap();
    let near = (1.0 / 0.7 + 0.626) / 1.035;
    assert!((limits.front_acceptable_m - 0.065 * (1.0 - 0.7 * near)).abs() < 1e-15);
    // From 2.26 m on (1/V < 0.442) everything to infinity is allowed: p = e.
    let far = zone.parallax_limits(&FAR).unwrap();
    assert!((far.behind_acceptable_m - 0.063).abs() < 1e-15);
    // On the paper's screen the zone would let a parallel target come to 0.9 m: it does not explain the 3 m limit.
    let nearest = 50.0 * 0.0065 * 0.07 / -limits.front_acceptable_m;
    assert!((nearest - 0.9).abs() < 0.05, "{nearest}");
}

/// Rules that are not over horizontal parallax, by hand.
#[test]
fn other_measures_by_hand() {
    let vertical = VerticalParallax::default();
    assert!(
        (vertical.measure(-0.7 * (10.0_f64 / 60.0).to_radians().tan(), &NEAR) - 10.0).abs() < 1e-12
    );
    let roundness = Roundness::default().measure(0.07, 1.0, &NEAR.viewer);
    assert!((roundness - 0.7 * 0.07 / 0.065).abs() < 1e-15);
    let ortho = Orthostereo::default();
    let true_size = ortho.measure(0.065, 0.014, 50.0, &NEAR.viewer);
    assert!(true_size.deviation < 1e-14);
    let paper = ortho.measure(0.07, 0.0065, 50.0, &NEAR.viewer);
    assert!((paper.perspective_ratio - 0.7 / 0.325).abs() < 1e-12);
    // Orthostereo with the screen at V: sizes are true at every distance (p = e (z - V) / z).
    for z in [0.35, 0.7, 3.0] {
        let p = 0.065 * (z - 0.7) / z;
        let size = PuppetTheatre::size_ratio(50.0, 0.014, z, p, &NEAR.viewer);
        assert!((size - 1.0).abs() < 1e-12, "{z} {size}");
    }
    let window = Rule::WindowViolation(WindowViolation);
    assert_eq!(
        window
            .verdict(WindowViolation.measure(-0.002, 0.0), &NEAR)
            .band,
        Band::Excessive
    );
    let mask = floating_window(-0.002, 0.001);
    assert_eq!((mask.left_of_left_m, mask.right_of_right_m), (0.002, 0.0));
    assert_eq!(
        window
            .verdict(WindowViolation.measure(-0.002, -mask.left_of_left_m), &NEAR)
            .band,
        Band::Comfortable
    );
    let keystone = Rule::by_id("keystone").unwrap();
    assert_eq!(keystone.verdict(1.5, &NEAR).band, Band::Acceptable);
    assert_eq!(keystone.verdict(f64::NAN, &NEAR).band, Band::Excessive);
}
