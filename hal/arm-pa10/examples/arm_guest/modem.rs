//! A USB adapter whose driver does not report its latency timer (cdc_acm), as many microcontrollers are. Both its ends are in
//! this computer: dummy_hcd is a USB port that is connected to itself.

use std::error::Error;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::time::Duration;

use pb3dp_arm_pa10::serial::{Latency, PortKind, SerialLink, ports};
use pb3dp_hal_platform::realtime::now;
use pb3dp_hal_platform::transport::{ByteLink, wait};
use rustix::mount::{MountFlags, mount};

use crate::report::{Outcome, ensure};
use crate::serial::{SLOW_CYCLE, carry, config};
use crate::system::wait_for;

/// Numbers that are not assigned to any vendor.
const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;
const BAUD: u32 = 921_600;

const CONFIGFS: &str = "/sys/kernel/config";
const FAR_END: &str = "/dev/ttyGS0";

/// The far end has no line, and keeps the rate that it reports: it cannot be set to another one.
const FAR_BAUD: u32 = 9600;
const FAR_CYCLE: Duration = Duration::from_secs(1);

/// Maximum time from the unplugging to the error.
const NOTICED_IN: Duration = Duration::from_millis(500);

/// Creates the device and plugs it in.
fn plug() -> Result<(), Box<dyn Error>> {
    mount("configfs", CONFIGFS, "configfs", MountFlags::empty(), None)?;
    let gadget = Path::new(CONFIGFS).join("usb_gadget/modem");
    for folder in ["", "strings/0x409", "configs/c.1", "functions/acm.0"] {
        fs::create_dir(gadget.join(folder)).map_err(|error| format!("gadget `{folder}`: {error}"))?;
    }
    let args = [
        ("idVendor", format!("{VENDOR:#06x}")),
        ("idProduct", format!("{PRODUCT:#06x}")),
        ("strings/0x409/product", "modem".to_owned()),
        ("strings/0x409/serialnumber", "MODEM".to_owned()),
    ];
    for (file, text) in args {
        fs::write(gadget.join(file), text).map_err(|error| format!("gadget `{file}`: {error}"))?;
    }
    symlink(gadget.join("functions/acm.0"), gadget.join("configs/c.1/acm.0"))?;
    let mut controllers = fs::read_dir("/sys/class/udc")?;
    let controller = controllers.next().ok_or("dummy_hcd gives no USB controller")??.file_name();
    fs::write(gadget.join("UDC"), controller.as_encoded_bytes())?;
    Ok(())
}

fn unplug() -> std::io::Result<()> {
    fs::write(Path::new(CONFIGFS).join("usb_gadget/modem/UDC"), "\n")
}

/// Is found, causes a warning, is used, and is unplugged.
pub fn check() -> Outcome {
    plug()?;
    let is_it = |kind: &PortKind| {
        matches!(kind, PortKind::Usb { vendor_id: VENDOR, product_id: PRODUCT, serial_number: Some(number), .. }
            if number == "MODEM")
    };
    let path = wait_for("the modem is found", || ports().ok()?.into_iter().find(|port| is_it(&port.kind)))?.path;
    let mut link = SerialLink::open(&config(&path, BAUD, SLOW_CYCLE))?;
    ensure(*link.latency() == Latency::Unknown, || format!("{path}: {:?}", link.latency()))?;
    let warning = link.warning().ok_or("nobody is warned of a timer that is not known")?;
    ensure(warning.contains(&path), || warning.clone())?;
    let mut far = SerialLink::open(&config(FAR_END, FAR_BAUD, FAR_CYCLE))?;
    ensure(far.warning().is_none(), || {
        format!("{FAR_END} is no adapter, and there is a warning: {:?}", far.warning())
    })?;
    carry(&mut link, &mut far)?;
    carry(&mut far, &mut link)?;
    unplug()?;
    let begin = now();
    let gone = loop {
        wait(Some(&link), false, None, Duration::from_millis(5));
        if let Err(gone) = link.try_read(&mut [0; 64]) {
            break gone;
        }
        ensure(now().saturating_since(begin) < NOTICED_IN, || "it was pulled out, and nobody notices".into())?;
    };
    let after = now().saturating_since(begin);
    Ok(format!("{warning}; pulled out: {} after {:.1} ms", gone.symptom, after.as_secs_f64() * 1e3))
}
