//! Serial lines: four USB adapters, two at the ends of each cable. One end belongs to the program, the other to an arm.

use std::error::Error;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use pb3dp_arm_pa10::serial::{PortDescription, PortKind, SerialConfig, ports};
use pb3dp_arm_pa10_emulation::line::mock_server::MockFace;
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_hal_platform::transport::Connector;
use pb3dp_setup::setup::{ArmLink, ArmSetup, GatewayWay};

use crate::report::Outcome;
use crate::system::wait_for;

/// Path of the adapter with this serial number.
fn adapter(number: &str) -> Result<String, Box<dyn Error>> {
    let wanted =
        |port: &PortDescription| matches!(&port.kind, PortKind::Usb { serial_number: Some(own), .. } if own == number);
    let find = || ports().ok()?.into_iter().find(wanted).map(|port| port.path);
    wait_for(&format!("the adapter {number} is found"), find)
}

/// The port of the program under the name in the setup, which udev creates on a real host.
fn port(arm: &ArmSetup) -> Result<SerialConfig, Box<dyn Error>> {
    match &arm.link {
        ArmLink::Gateway(link, GatewayWay::Serial { path, baud }) => {
            Ok(SerialConfig::of_link(path.clone(), *baud, link))
        }
        other => Err(format!("the setup has no arm on a serial port: {other:?}").into()),
    }
}

/// Creates a link with the setup's name to the adapter `own`.
pub fn name_port(arm: &ArmSetup, own: &str) -> Outcome {
    let port = port(arm)?;
    let path = Path::new(&port.path);
    fs::create_dir_all(path.parent().ok_or("a name without a folder")?)?;
    let adapter = adapter(own)?;
    symlink(&adapter, path)?;
    Ok(format!("{} is {adapter}", path.display()))
}

/// The arm's end of the line, at the adapter `far`.
pub fn far_end(arm: &ArmSetup, far: &str) -> Result<impl FnOnce(GatewayConfig) -> MockFace, Box<dyn Error>> {
    let mut port = SerialConfig { path: adapter(far)?, ..port(arm)? };
    let link = port.connect().map_err(|error| -> Box<dyn Error> { error })?;
    Ok(move |gateway| MockFace::Link(gateway, link))
}
