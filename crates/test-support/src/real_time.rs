//! Tests whose threads must meet real-time deadlines.

use std::any::{Any, type_name};
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::not_checked;
use crate::scheduling::{Entered, Policy, Preferred};
use crate::verdict::{Tries, Verdict, judge};
use crate::witness::{Delay, TOO_LATE, Witness, of};

/// Delays recorded by the threads of the running test.
static OWN: Mutex<Vec<Delay>> = Mutex::new(Vec::new());

/// A late machine must be on time for this long before a test is tried again.
const CALM: Duration = Duration::from_secs(1);
/// Longest wait for a calm machine.
const TIMEOUT: Duration = Duration::from_secs(20);

/// How a test holds the lock of all real-time tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// No other real-time test runs.
    Alone,
    /// Other tests of this kind may run: the test mostly sleeps, and leaves most of a cycle to others.
    BesideOthers,
}

/// Priority of the threads of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// A SCHED_FIFO priority, if granted.
    Granted,
    /// The default policy, preferred over most threads if granted, unless a thread requests a priority itself.
    Usual,
}

/// Records that a thread of the running test was late now, by its own measurement.
pub fn note_lateness(late: Duration) {
    note_lateness_at(Instant::now(), late);
}

/// As [`note_lateness`], for a delay that is read after it ended: it is compared with the witnesses at the time when it ended.
pub fn note_lateness_at(at: Instant, late: Duration) {
    of(&OWN).push(Delay { at, late });
}

/// Runs a test whose threads must meet deadlines: under one lock of all such tests of this user, in any process, with a
/// SCHED_FIFO priority if granted, beside witness threads that observe the machine. No other such test runs at the same time.
///
/// A failure counts at once if the machine met its deadlines. If the machine was late, the test is tried again after the machine
/// was on time for a second (or after 20 s), up to [`Tries::MAX`] times. If no try passes, the test fails, unless each failure was
/// lateness and the machine was equally late at that time; then the test is reported as not checked. The behaviour of an arm on a
/// late machine is tested in virtual time, and in the emulated computer.
///
/// # Panics
/// If the test fails.
pub fn in_real_time<T: Fn()>(test: T) {
    in_real_time_as(&name_of::<T>(), Turn::Alone, Priority::Granted, test);
}

/// As [`in_real_time`], for a test that mostly sleeps: other tests of this kind may run at the same time.
///
/// # Panics
/// If the test fails.
pub fn in_real_time_beside_others<T: Fn()>(test: T) {
    in_real_time_as(&name_of::<T>(), Turn::BesideOthers, Priority::Granted, test);
}

/// As [`in_real_time_beside_others`], for a test of programs or threads with computing load: they request the priority that they
/// need themselves, as on a rig. With a priority for all their computing they would block the communication lines on which they
/// depend.
///
/// # Panics
/// If the test fails.
pub fn programs_in_real_time_beside_others<T: Fn()>(test: T) {
    in_real_time_as(&name_of::<T>(), Turn::BesideOthers, Priority::Usual, test);
}

/// Runs a test with each of these cases, all at once: they mostly sleep.
///
/// # Panics
/// If a case fails: with its panic, the first in their order.
pub fn beside_each_other<Case: Send, const N: usize>(cases: [Case; N], test: impl Fn(Case) + Sync) {
    let test = &test;
    std::thread::scope(|scope| {
        let running = cases.map(|case| scope.spawn(move || test(case)));
        running.into_iter().for_each(|case| case.join().unwrap_or_else(|panic| resume_unwind(panic)));
    });
}

/// As [`in_real_time`], for a test whose name does not follow from its type.
///
/// # Panics
/// If the test fails.
pub fn in_real_time_as(name: &str, turn: Turn, priority: Priority, test: impl Fn()) {
    let _turn = take_turn(turn);
    let mut tries = Tries::default();
    loop {
        let begin = Instant::now();
        let preferred = (priority == Priority::Usual).then(Preferred::new);
        let of_witness = if priority == Priority::Granted { Policy::WITNESS } else { Policy::current() };
        let witness = Witness::start(of_witness).expect("threads and a line that watch the machine");
        let entered = (priority == Priority::Granted).then(|| Entered::new(Policy::TEST));
        let outcome = catch_unwind(AssertUnwindSafe(&test));
        drop((entered, preferred));
        let testimony = witness.end();
        let Err(panic) = outcome else { return };
        let own: Vec<Delay> = of(&OWN).iter().filter(|delay| delay.at >= begin).copied().collect();
        let blame = judge(text(panic.as_ref()), &own, &testimony);
        let own_worst = own.iter().map(|delay| delay.late).max().unwrap_or_default();
        #[expect(clippy::print_stderr, reason = "belongs to the captured output of the test")]
        {
            eprintln!("cause of the failure: {blame:?} (machine {:?} late, test {own_worst:?} late)", testimony.worst);
        }
        match tries.failed(blame, &testimony) {
            Verdict::Failed => resume_unwind(panic),
            Verdict::NotChecked { worst } => {
                let reason =
                    format!("this machine delays threads by {worst:?}; last failure: {}", text(panic.as_ref()));
                return not_checked(name, &reason);
            }
            Verdict::Open => wait_for_calm(of_witness),
        }
    }
}

/// Waits until the machine is on time, so that one long delay does not cost all tries.
fn wait_for_calm(of_witness: Policy) {
    let begin = Instant::now();
    while begin.elapsed() < TIMEOUT {
        let witness = Witness::start(of_witness).expect("threads and a line that watch the machine");
        std::thread::sleep(CALM);
        if witness.end().worst <= TOO_LATE {
            return;
        }
    }
}

/// The path of a test from the type of its closure: `integration::real_time::io_arm::a_name::{{closure}}`.
fn name_of<T>() -> String {
    let name = type_name::<T>().split("::{{closure}}").next().unwrap_or_default();
    name.split_once("::").map_or(name, |(_crate, path)| path).to_owned()
}

fn text(panic: &(dyn Any + Send)) -> &str {
    let owned = panic.downcast_ref::<String>().map(String::as_str);
    owned.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a text")
}

/// Waits until the test may run. The lock is held while the file is open.
fn take_turn(turn: Turn) -> File {
    let name = format!("pb3dp-real-time-tests-{}.lock", rustix::process::geteuid().as_raw());
    let path = std::env::temp_dir().join(name);
    let file = File::options().create(true).truncate(false).write(true).open(path).expect("a file to lock");
    match turn {
        Turn::Alone => file.lock(),
        Turn::BesideOthers => file.lock_shared(),
    }
    .expect("the lock of all tests in real time");
    file
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[test]
    fn a_test_has_the_name_of_its_function() {
        fn of_closure<T: Fn()>(_: T) -> String {
            name_of::<T>()
        }
        assert_eq!(of_closure(|| {}), "real_time::tests::a_test_has_the_name_of_its_function");
    }

    #[test]
    fn a_failure_of_the_product_is_not_lost() {
        let tries = AtomicU32::new(0);
        let failed = catch_unwind(AssertUnwindSafe(|| {
            in_real_time(|| {
                tries.fetch_add(1, Ordering::SeqCst);
                resume_unwind(Box::new("moved by 0.3 rad"));
            });
        }));
        assert!(failed.is_err());
        assert!((1..=Tries::MAX).contains(&tries.load(Ordering::SeqCst)));
    }

    #[test]
    fn a_test_that_passes_runs_once() {
        let tries = AtomicU32::new(0);
        in_real_time(|| {
            tries.fetch_add(1, Ordering::SeqCst);
        });
        assert_eq!(tries.load(Ordering::SeqCst), 1);
    }
}
