//! The same seed gives the same run to the last bit; another seed gives another run.

use pb3dp_cell::report::{self, Made};
use pb3dp_estimation::estimator::Method;
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::Channel;

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
    report::tell(dir.path(), setup, &Made::default(), &outcome, Ok(()), |_| Ok(())).unwrap();
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
