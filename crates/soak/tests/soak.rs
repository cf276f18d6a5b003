//! Proves: on a few seeds the whole loop survives everything that is planted, the same seed gives the same run, and the watcher catches bugs that are planted
//! in the simulation. The long run is `cargo xtask soak`.
// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

use vergence_soak::{Bug, Plan, Verdict, run};

fn plan(seed: u64) -> Plan {
    Plan {
        seed,
        seconds: 32.0,
        bug: None,
        trace: false,
        most_mib: u64::MAX,
    }
}

/// Each plan on a thread of its own, two at a time.
fn all(plans: &[Plan]) -> Vec<Verdict> {
    let mut verdicts = Vec::new();
    for two in plans.chunks(2) {
        verdicts.extend(std::thread::scope(|scope| {
            let running: Vec<_> = two
                .iter()
                .map(|plan| {
                    scope.spawn(|| {
                        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
                        pool.unwrap().install(|| run(*plan)).unwrap()
                    })
                })
                .collect();
            let done = running.into_iter().map(|r| r.join().unwrap());
            done.collect::<Vec<_>>()
        }));
    }
    verdicts
}

/// The first two seeds, one of them with several faults at a time: nothing that must never be, and the axes were not simply held all the time. The
/// same seed again is the same run to the last step.
#[test]
fn the_first_seeds() {
    let verdicts = all(&[plan(1), plan(2), plan(2)]);
    for verdict in &verdicts {
        assert_eq!(
            verdict.count, 0,
            "seed {}: {:#?}",
            verdict.seed, verdict.violations
        );
        assert!(verdict.moving > 0.25, "{verdict:?}");
    }
    assert_eq!(verdicts[1].fingerprint, verdicts[2].fingerprint);
    assert_ne!(verdicts[0].fingerprint, verdicts[1].fingerprint);
}

/// Orders to hold that do not arrive, a fault that clears itself, and a chunk of the recording that is lost: each is caught.
#[test]
fn planted_bugs_are_caught() {
    let bugs = [
        (Bug::HoldIgnored, 2, "motion was sent"),
        (Bug::ClearsItself, 16, "no person had asked"),
        (Bug::ChunkLost, 1, "written"),
    ];
    let verdicts = all(&bugs.map(|(bug, seed, _)| Plan {
        bug: Some(bug),
        ..plan(seed)
    }));
    for ((bug, _, word), verdict) in bugs.into_iter().zip(verdicts) {
        let told = verdict.violations.iter().any(|text| text.contains(word));
        assert!(told, "{bug:?} was not caught: {verdict:#?}");
    }
}
