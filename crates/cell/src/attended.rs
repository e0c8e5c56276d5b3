//! The operator of a run without a console, beside arms that are not emulated.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest, State};

use super::console::Console;
use super::operator::{ByCommand, Operator};

/// [`ByCommand`] beside arms that are not emulated: the keys of a console are the sign of life, and its commands are obeyed.
///
/// The program starts by itself at most once, and only while the operator has typed no command and was never silent: a person who typed
/// `hold` wants no motion, and one who was away does not see what begins to move.
pub struct AttendedCommand {
    console: Console,
    /// The program may still select and start by itself.
    leads: bool,
    /// Last sign of life of the step before.
    heartbeat_at: Option<MonotonicTime>,
    /// The operator knows that `start` is needed.
    is_reported: bool,
}

impl AttendedCommand {
    /// An operator with the lines of this console.
    pub fn new(console: Console) -> Self {
        Self { console, leads: true, heartbeat_at: None, is_reported: false }
    }

    /// Whether the operator has been silent up to this step for as long as a silence lasts.
    fn was_silent(&mut self, input: &OperatorInput, now: MonotonicTime) -> bool {
        let (Some(heartbeat_at), Some(silent_after)) = (input.heartbeat_at, input.silent_after) else { return true };
        let before = self.heartbeat_at.replace(heartbeat_at).unwrap_or(heartbeat_at);
        let is_long = |silence: Duration| silence >= silent_after;
        is_long(heartbeat_at.saturating_since(before)) || is_long(now.saturating_since(heartbeat_at))
    }
}

impl Operator for AttendedCommand {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let input = self.console.listen(last, now);
        let was_silent = self.was_silent(&input, now);
        // In any other state the first start is over, or something else needs the operator.
        let is_before_start = last.is_none_or(|last| matches!(last.state, State::Idle | State::Selecting));
        self.leads &= is_before_start && !was_silent && !self.console.has_typed();
        let own = ByCommand::next(last);
        if self.leads {
            let request = input.request.or_else(|| own.map(|command| OperatorRequest { command, at: now }));
            return OperatorInput { request, ..input };
        }
        if own == Some(OperatorCommand::Start) && !std::mem::replace(&mut self.is_reported, true) {
            self.console.say_no_start();
        }
        input
    }

    fn show(&mut self, decision: &Decision) {
        self.console.show(decision);
    }

    fn tell(&mut self, trouble: Option<String>) {
        self.console.tell(trouble);
    }

    fn answer(&mut self, result: String) {
        self.console.answer(result);
    }

    fn is_person(&self) -> bool {
        false
    }

    fn carries_before_start(&self) -> bool {
        self.leads
    }

    fn can_fall_silent(&self) -> bool {
        self.console.can_fall_silent()
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufReader, PipeWriter, Write, pipe};
    use std::sync::Arc;
    use std::time::Instant;

    use pb3dp_hal_api::Clock;
    use pb3dp_hal_clock::VirtualClock;

    use super::*;
    use crate::console::ConsoleOptions;
    use crate::console::tests::decision;

    const KEY_WITHIN: Duration = Duration::from_secs(5);

    /// The operator of a run, what it may hear, and the time.
    struct Run {
        operator: AttendedCommand,
        typing: PipeWriter,
        clock: Arc<VirtualClock>,
    }

    impl Run {
        /// The program has selected the target, at 1 s.
        fn new() -> Self {
            let (lines, typing) = pipe().unwrap();
            let clock = Arc::new(VirtualClock::new());
            let options = ConsoleOptions { interrupt: Arc::default(), prompt: "", targets: None };
            let reading: Arc<dyn Clock> = clock.clone();
            let console = Console::start(reading, BufReader::new(lines), std::io::sink(), options).unwrap();
            let operator = AttendedCommand::new(console.with_keys(KEY_WITHIN));
            let mut run = Self { operator, typing, clock };
            assert_eq!(run.request(None, 1.0), Some(OperatorCommand::Select));
            run
        }

        /// The command of a step.
        fn request(&mut self, last: Option<Decision>, at_s: f64) -> Option<OperatorCommand> {
            let now = MonotonicTime::from_secs_f64(at_s);
            self.clock.sleep_until(now);
            let request = self.operator.listen(last.as_ref(), now).request.map(|request| request.command);
            self.operator.show(&last.unwrap_or_else(decision));
            request
        }

        /// Types a line; steps of 10 ms until it is heard. Returns the command that was heard first.
        fn types(&mut self, line: &str, last: Decision, at_s: f64) -> Option<OperatorCommand> {
            self.clock.sleep_until(MonotonicTime::from_secs_f64(at_s));
            writeln!(self.typing, "{line}").unwrap();
            let begin = Instant::now();
            let before = self.operator.heartbeat_at;
            loop {
                let request = self.request(Some(last), at_s);
                if request.is_some() || self.operator.heartbeat_at > before {
                    return request;
                }
                assert!(begin.elapsed() < Duration::from_secs(30), "{line}");
                std::thread::sleep(Duration::from_millis(1));
            }
        }

        /// As [`Self::types`], for a line with a command, which may be heard after its line.
        fn commands(&mut self, line: &str, last: Decision, at_s: f64) -> Option<OperatorCommand> {
            let mut request = self.types(line, last, at_s);
            for _ in 0..30_000 {
                request = request.or_else(|| {
                    std::thread::sleep(Duration::from_millis(1));
                    self.request(Some(last), at_s)
                });
            }
            request
        }

        /// Nothing is said for two seconds in which the target is ready; then a typed `start` is.
        fn needs_a_typed_start(&mut self, from_s: f64) {
            for step in 0..20 {
                assert_eq!(self.request(Some(ready()), from_s + f64::from(step) * 0.1), None, "step {step}");
            }
            assert!(!self.operator.carries_before_start());
            assert_eq!(self.commands("start", ready(), from_s + 2.0), Some(OperatorCommand::Start));
        }
    }

    /// The target is selected but not seen.
    fn selecting() -> Decision {
        Decision { state: State::Selecting, ..decision() }
    }

    /// The same, and `start` is possible.
    fn ready() -> Decision {
        Decision { is_ready: true, ..selecting() }
    }

    #[test]
    fn the_program_starts_by_itself_once_if_nobody_types() {
        let mut run = Run::new();
        assert_eq!(run.request(Some(selecting()), 1.1), None);
        assert!(run.operator.carries_before_start());
        // Enter is a sign of life, no command.
        assert_eq!(run.types("", selecting(), 3.0), None);
        assert_eq!(run.request(Some(ready()), 3.1), Some(OperatorCommand::Start));
        let approaching = Decision { state: State::Approaching, ..decision() };
        assert_eq!(run.request(Some(approaching), 3.2), None);
        run.needs_a_typed_start(3.3);
    }

    #[test]
    fn the_program_does_not_start_after_a_hold_or_any_other_command() {
        use OperatorCommand::{Hold, HoldHand, Resume, Select, Stop};
        for (line, command) in
            [("hold", Hold), ("stop", Stop), ("hold hand", HoldHand), ("select", Select), ("resume", Resume)]
        {
            let mut run = Run::new();
            assert_eq!(run.commands(line, selecting(), 1.1), Some(command));
            run.needs_a_typed_start(1.5);
        }
        for line in ["status", "hodl"] {
            let mut run = Run::new();
            assert_eq!(run.types(line, selecting(), 1.1), None);
            run.needs_a_typed_start(1.5);
        }
    }

    #[test]
    fn a_selection_after_a_hold_starts_nothing_by_itself() {
        let mut run = Run::new();
        assert_eq!(run.request(Some(ready()), 1.1), Some(OperatorCommand::Start));
        let [tracking, holding] = [State::Tracking, State::Holding].map(|state| Decision { state, ..decision() });
        run.types("hold", tracking, 1.2);
        run.types("select", holding, 1.5);
        run.request(Some(holding), 1.6);
        run.needs_a_typed_start(1.7);
    }

    #[test]
    fn enter_after_a_silence_starts_nothing() {
        let mut run = Run::new();
        assert_eq!(run.request(Some(selecting()), 5.9), None);
        assert_eq!(run.request(Some(selecting()), 6.1), None);
        assert_eq!(run.types("", ready(), 8.0), None);
        run.needs_a_typed_start(8.1);
        // The same if no step saw the silence, because the program was suspended.
        let mut run = Run::new();
        assert_eq!(run.types("", ready(), 8.0), None);
        run.needs_a_typed_start(8.1);
    }
}
