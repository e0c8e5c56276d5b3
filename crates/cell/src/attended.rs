//! The operator of a run without a console, beside arms that are not emulated.

use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Decision, OperatorInput, OperatorRequest};

use super::console::Console;
use super::operator::{ByCommand, Operator};

/// [`ByCommand`] beside arms that are not emulated: the keys of a console are the sign of life, and its commands are obeyed.
pub struct AttendedCommand(pub Console);

impl Operator for AttendedCommand {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let heard = self.0.listen(last, now);
        let said = heard.said.or_else(|| ByCommand::next(last).map(|word| OperatorRequest { word, at: now }));
        OperatorInput { said, ..heard }
    }

    fn show(&mut self, decision: &Decision) {
        self.0.show(decision);
    }

    fn tell(&mut self, trouble: Option<String>) {
        self.0.tell(trouble);
    }

    fn answer(&mut self, result: String) {
        self.0.answer(result);
    }

    fn is_person(&self) -> bool {
        false
    }

    fn can_fall_silent(&self) -> bool {
        self.0.can_fall_silent()
    }
}
