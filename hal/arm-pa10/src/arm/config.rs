//! Settings of an arm, and errors at its creation.

use std::time::Duration;

use super::request::RequestError;
use crate::driver::{DriverConfig, DriverConfigError};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::transport::ConnectError;

/// Above ordinary programs, below the interrupts of the system.
pub const REALTIME: Realtime = Realtime { priority: Some(50), locks_memory: true, cpu: None };

/// Settings of an arm behind a gateway.
#[derive(Clone, Debug, PartialEq)]
pub struct Pa10ArmConfig {
    /// Name for messages: `vs-robot`.
    pub name: String,
    /// Settings of the driver.
    pub driver: DriverConfig,
    /// Settings of the link.
    pub link: GatewayLinkConfig,
    /// Requested real-time scheduling of the thread. Without it other programs delay its cycles.
    pub realtime: Realtime,
}

impl Pa10ArmConfig {
    /// Settings of an arm with this name; its thread requests real-time scheduling.
    pub fn new(name: &str, driver: DriverConfig, link: GatewayLinkConfig) -> Self {
        Self { name: name.to_owned(), driver, link, realtime: REALTIME }
    }
}

/// Why an arm cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum ArmOpenError {
    /// The configuration contradicts itself.
    #[error("arm {arm}")]
    Config {
        /// Name of the arm.
        arm: String,
        /// The contradiction.
        #[source]
        source: DriverConfigError,
    },
    /// Driver and link have different cycles.
    #[error("arm {arm}: the driver has a cycle of {driver:?}, the link one of {link:?}: give both the same cycle")]
    Cycles {
        /// Name of the arm.
        arm: String,
        /// Cycle of the driver.
        driver: Duration,
        /// Cycle of the link.
        link: Duration,
    },
    /// The link cannot be opened.
    #[error("arm {arm}: {target} cannot be opened")]
    Open {
        /// Name of the arm.
        arm: String,
        /// Name of the other end.
        target: String,
        /// The reason.
        #[source]
        source: ConnectError,
    },
    /// The operating system provides no thread.
    #[error("arm {arm}: cannot start its thread")]
    Thread {
        /// Name of the arm.
        arm: String,
        /// The reason.
        #[source]
        source: std::io::Error,
    },
    /// There is no arm at the other end of the link.
    #[error("arm {arm}")]
    Connect {
        /// Name of the arm.
        arm: String,
        /// The reason.
        #[source]
        source: RequestError,
    },
}
