//! Flight records of a run that goes on after a fault.

use super::*;

/// A fault does not end the run of a person, and the recorders forget it after 5 s: their files are written at the fault.
#[test]
fn a_fault_is_recorded_although_the_run_goes_on() {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let kept = Arc::<Mutex<Vec<(usize, f64, f64, String)>>>::default();
    let (clock, [(_, flight), _], keeps) = (Arc::clone(&parts.clock), parts.flights.clone(), Arc::clone(&kept));
    let keep_flights = Box::new(move |number: usize, failure: &anyhow::Error| {
        let seconds = |at: MonotonicTime| at.seconds_since(MonotonicTime::ZERO);
        let begin_s = seconds(flight.entries()[0].at);
        keeps.lock().unwrap().push((number, begin_s, seconds(clock.now()), format!("{failure:#}")));
    });
    let vs = Stoppable::new(parts.vs, &parts.clock, &[(3.0, 4.0)]);
    let commands = vec![BEGIN[0], BEGIN[1], (4.5, OperatorCommand::Reset), (6.0, OperatorCommand::Stop)];
    let operator = Box::new(Person { commands, silent: (0.0, 0.0), resets_late_s: 0.0, troubles: Arc::default() });
    let parts = Parts { vs: Box::new(vs), operator, keep_flights, ..parts };
    let Ended { how, faults, .. } = conduct(&setup, parts, Some(12.0), None).unwrap();
    assert!(how.is_ok() && faults == 1, "{how:?} {faults}");
    let kept = kept.lock().unwrap();
    assert_eq!(kept.len(), 2, "a stop by command is no fault: {kept:?}");
    for ((number, begin_s, at_s, cause), wanted_s) in kept.iter().zip([3.0, 4.0]) {
        assert!(*number == 1 && *begin_s < 2.0 && cause.contains("emergency stop"), "{kept:?}");
        assert!((wanted_s..wanted_s + 0.5).contains(at_s), "{kept:?}");
    }
}
