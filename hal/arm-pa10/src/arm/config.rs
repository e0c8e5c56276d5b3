//! Settings of an arm, and why there may be none.

use std::time::Duration;

use super::request::WishError;
use crate::driver::{DriverConfig, DriverConfigError};
use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use pb3dp_arm_pa10_protocol::places::{BusTarget, GatewayLinkConfig};
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::transport::ConnectError;

/// Above ordinary programs, below the interrupts of the system.
pub const REALTIME: Realtime = Realtime { priority: Some(50), locks_memory: true, cpu: None };

/// Settings of an arm behind a gateway.
#[derive(Clone, Debug, PartialEq)]
pub struct Pa10ArmConfig {
    /// For messages: `vs-robot`.
    pub name: String,
    /// Of the driver.
    pub driver: DriverConfig,
    /// Of the link.
    pub link: GatewayLinkConfig,
    /// What the thread asks the system for. Without it other programs delay its cycles.
    pub realtime: Realtime,
}

/// Settings of an arm whose ARCNET card is in this computer. Nothing but the servo controller stands between program and arm then:
/// where its time-out is not known, a gateway is the safer way.
#[derive(Clone, Debug, PartialEq)]
pub struct BusArmConfig {
    /// For messages: `vs-robot`.
    pub name: String,
    /// Which arm it is, to the others of its cell.
    pub arm: ArmId,
    /// Of the driver, with the cycle of the bus: 2 ms.
    pub driver: DriverConfig,
    /// Time between two exchanges of the control loop: from the cycle of the bus to half of what the watchdog allows.
    pub exchange_cycle: Duration,
    /// How the controller speaks.
    pub format: WireFormat,
    /// How it counts messages.
    pub modulus: SequenceModulus,
    /// Where the bus is.
    pub target: BusTarget,
    /// What the thread asks the system for. Without it other programs delay its cycles.
    pub realtime: Realtime,
}

impl Pa10ArmConfig {
    /// An arm with this name; its thread asks for real time.
    pub fn new(name: &str, driver: DriverConfig, link: GatewayLinkConfig) -> Self {
        Self { name: name.to_owned(), driver, link, realtime: REALTIME }
    }
}

/// Why there is no arm.
#[derive(Debug, thiserror::Error)]
pub enum ArmOpenError {
    /// The configuration contradicts itself.
    #[error("arm {arm}")]
    Config {
        /// Its name.
        arm: String,
        /// How.
        #[source]
        source: DriverConfigError,
    },
    /// Driver and link have different cycles.
    #[error("arm {arm}: a cycle of {driver:?} in the driver and of {link:?} in the link: give one to both")]
    Cycles {
        /// Its name.
        arm: String,
        /// Of the driver.
        driver: Duration,
        /// Of the link.
        link: Duration,
    },
    /// The control loop would be quicker than the bus, or too slow for its watchdog.
    #[error(
        "arm {arm}: {got:?} between two exchanges: give at least the cycle of the bus ({bus:?}) and at most half of the time after \
         which commands fade"
    )]
    ExchangeCycle {
        /// Its name.
        arm: String,
        /// The time given.
        got: Duration,
        /// Of the bus.
        bus: Duration,
    },
    /// The link cannot be opened.
    #[error("arm {arm}: {target} cannot be opened")]
    Open {
        /// Its name.
        arm: String,
        /// Where it leads.
        target: String,
        /// Why not.
        #[source]
        source: ConnectError,
    },
    /// The operating system gives no thread.
    #[error("arm {arm}: no thread for it")]
    Thread {
        /// Its name.
        arm: String,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// There is no arm at the end of the link.
    #[error("arm {arm}")]
    Connect {
        /// Its name.
        arm: String,
        /// Why not.
        #[source]
        source: WishError,
    },
}
