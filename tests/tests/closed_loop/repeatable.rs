//! The same seed gives the same run to the last bit; another seed gives another run.

use std::time::{Duration, Instant};

use pb3dp_cell::report::{self, Made};
use pb3dp_estimation::estimator::Method;
use pb3dp_setup::setup::{Pace, Setup, read_setup};
use pb3dp_sim::camera_faults::{CameraFault, CameraFaultKind};
use pb3dp_sim::trajectory::Channel;
use system_tests::repository;

use crate::closed_loop::support::*;

/// All records of a run, without those that depend on the machine's speed: the file of the time series, and the log with
/// numbers to the last bit.
fn traces(setup: &Setup) -> (String, String) {
    let mut outcome = run(setup, Some(1.3));
    let log = &mut outcome.log;
    for frame in std::iter::once(&mut log.leading).chain(&mut log.compared).flat_map(|method| &mut method.frames) {
        assert!(frame.latency_millis > 0.0);
        frame.latency_millis = 0.0;
    }
    let dir = tempfile::tempdir().unwrap();
    report::write_report(dir.path(), setup, &Made::default(), &outcome, Ok(()), |_| Ok(())).unwrap();
    assert!(dir.path().join("report.html").exists() && dir.path().join("summary.json").exists());
    let series = std::fs::read_to_string(dir.path().join("timeseries.csv")).unwrap();
    assert_eq!(series.lines().count(), 1 + outcome.log.control.len());
    (series, format!("{:?}", outcome.log))
}

#[test]
fn the_seed_alone_decides_a_run() {
    let mut setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::Z]);
    setup.compared = vec![Method::Published];
    let first = traces(&setup);
    assert!(traces(&setup) == first, "the same seed gives the same run");
    setup.reseed(setup.seed + 1);
    assert!(traces(&setup).1 != first.1, "another seed gives another run");
}

/// At the pace of the wall clock a thread of its own renders and estimates; late, lost and blurred pairs, and arms behind an emulated line.
#[test]
fn the_pace_of_the_wall_clock_changes_no_bit() {
    let fault = |kind, from, until| CameraFault {
        kind,
        from: Duration::from_millis(from),
        until: Duration::from_millis(until),
    };
    let mut in_process = quick_setup(Method::Direct, Pixels::Few, &[Channel::Z]);
    let world = in_process.world.as_mut().unwrap();
    world.blur_moments = 2;
    world.faults.list = vec![
        fault(CameraFaultKind::Late { pairs: 1 }, 400, 600),
        fault(CameraFaultKind::Dropped { share: 0.3 }, 600, 1300),
    ];
    let mut behind_a_line = quick_setup(Method::Direct, Pixels::Few, &[Channel::Z]);
    behind_a_line.rig.arms = read_setup(&repository().join("configs/hil.toml")).unwrap().rig.arms;
    for mut setup in [in_process, behind_a_line] {
        setup.pace = Pace::Fast;
        let fast = traces(&setup);
        setup.pace = Pace::RealTime;
        let began = Instant::now();
        let paced = traces(&setup);
        assert!(began.elapsed() >= Duration::from_millis(1300));
        assert!(paced == fast, "the same result at both paces");
    }
}
