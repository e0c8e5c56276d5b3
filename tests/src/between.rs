//! An intermediary between a run and one of its arms.

use std::task::Poll;

use pb3dp_cell::parts::ArmControl;
use pb3dp_hal_api::{Arm, ArmError, ArmInfo, ArmPower, ArmState, JointCommand, JointState, PowerOrder};
use pb3dp_hal_middleware::LimiterStatistics;

type Exchange = dyn FnMut(&mut dyn ArmControl, JointCommand) -> Result<JointState, ArmError> + Send;

/// An arm whose exchanges go through the test; all other calls go to the arm itself.
pub struct Between {
    arm: Box<dyn ArmControl>,
    exchange: Box<Exchange>,
}

impl Between {
    /// `exchange` gets each command of the run, with the arm; the run gets its return value.
    pub fn boxed(
        arm: Box<dyn ArmControl>,
        exchange: impl FnMut(&mut dyn ArmControl, JointCommand) -> Result<JointState, ArmError> + Send + 'static,
    ) -> Box<dyn ArmControl> {
        Box::new(Self { arm, exchange: Box::new(exchange) })
    }
}

impl Arm for Between {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        (self.exchange)(&mut *self.arm, command)
    }
}

impl ArmPower for Between {
    fn state(&self) -> ArmState {
        self.arm.state()
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        self.arm.power(order)
    }

    fn is_stopped_by_other(&self) -> bool {
        self.arm.is_stopped_by_other()
    }
}

impl ArmControl for Between {
    fn statistics(&self) -> LimiterStatistics {
        self.arm.statistics()
    }
}
