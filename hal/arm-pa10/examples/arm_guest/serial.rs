//! Serial ports: two USB adapters at the ends of one cable, and built-in ports.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use pb3dp_arm_pa10::serial::{Latency, PortDescription, PortKind, SerialConfig, SerialError, SerialLink, ports};
use pb3dp_hal_platform::realtime::now;
use pb3dp_hal_platform::transport::{ByteLink, wait};
use rustix::termios::tcgetattr;

use crate::modem;
use crate::report::{Outcome, Report, ensure};
use crate::system::{LONG, User, as_user, wait_for};

/// The rates of docs/arm-protocol.md that are fast enough for a cycle, and the rates of adapters between them.
const BAUDS: [u32; 6] = [460_800, 500_000, 921_600, 1_000_000, 2_000_000, 3_000_000];

/// A rate that the chip of the adapters does not support.
const TOO_QUICK: u32 = 4_000_000;

/// A port that accepts every rate; the requested and the actual rate.
const LIAR: &str = "/dev/ttyS1";
const LIAR_ASKED: u32 = 1_000_000;
const LIAR_HAS: u32 = 115_200;

/// A cycle for which every rate is fast enough, so that no rate is refused as too slow.
pub const SLOW_CYCLE: Duration = Duration::from_millis(100);

/// Serial numbers and USB IDs of the adapters.
pub const HOST: &str = "HOST";
pub const GATEWAY: &str = "GATEWAY";
const FTDI: [u16; 2] = [0x0403, 0x6001];

pub fn config(path: &str, baud: u32, cycle: Duration) -> SerialConfig {
    SerialConfig { path: path.to_owned(), baud, cycle }
}

pub fn check(report: &mut Report) {
    report.check("ports are found, with what is known of each", discovery);
    report.check("USB: bytes are handed on at once, also for a user without rights", latency);
    report.check("USB: every rate is read back, and bytes go both ways", rates);
    report.check("USB: a rate that the chip does not have is refused with both values", too_quick);
    report.check("USB: a second program is refused, for any user", || exclusive(&adapter(HOST)?));
    report.check("USB: an adapter that does not tell its timer is warned of", modem::check);
    report.check("16550: a port that lies about its rate is refused with both values", liar);
    report.check("16550: a second program is refused, for any user", || exclusive(LIAR));
}

/// The path of the adapter with this serial number.
pub fn adapter(serial_number: &str) -> Result<String, Box<dyn Error>> {
    let wanted = |port: &PortDescription| matches!(&port.kind, PortKind::Usb { serial_number: Some(number), .. } if number == serial_number);
    wait_for(&format!("the adapter {serial_number} is found"), || {
        ports().ok()?.into_iter().find(wanted).map(|port| port.path)
    })
}

fn discovery() -> Outcome {
    let paths = [adapter(HOST)?, adapter(GATEWAY)?];
    let found = ports()?;
    let by_path: BTreeMap<_, _> = found.iter().map(|port| (port.path.as_str(), &port.kind)).collect();
    for path in &paths {
        let kind = by_path.get(path.as_str()).ok_or("a port has gone")?;
        let PortKind::Usb { vendor_id, product_id, product: Some(product), .. } = kind else {
            return Err(format!("{path}: {kind:?}").into());
        };
        ensure([*vendor_id, *product_id] == FTDI && !product.is_empty(), || format!("{path}: {kind:?}"))?;
    }
    for path in ["/dev/ttyS0", LIAR] {
        ensure(by_path.contains_key(path), || format!("{path} is missing: {by_path:?}"))?;
    }
    let texts: Vec<String> = found.iter().map(ToString::to_string).collect();
    Ok(texts.join(", "))
}

fn rates() -> Outcome {
    let mut figures = Vec::new();
    for baud in BAUDS {
        let open = |name| Ok::<_, Box<dyn Error>>(SerialLink::open(&config(&adapter(name)?, baud, SLOW_CYCLE))?);
        let (mut host, mut gateway) = (open(HOST)?, open(GATEWAY)?);
        for link in [&host, &gateway] {
            ensure(link.baud() == baud, || format!("{}: asked for {baud}, {} read back", link.name(), link.baud()))?;
            // Checked once more, without the library.
            let settings = tcgetattr(link.fd().ok_or("a port without a descriptor")?)?;
            let read = [settings.input_speed(), settings.output_speed()];
            ensure(read == [baud; 2], || format!("{}: the kernel says {read:?} at {baud}", link.name()))?;
        }
        let there = carry(&mut host, &mut gateway)?;
        let back = carry(&mut gateway, &mut host)?;
        figures.push(format!("{baud} ({} ms)", (there + back).as_millis()));
    }
    Ok(format!("2 x 512 bytes at {}", figures.join(", ")))
}

/// Sends bytes of every value through the cable; returns the time.
pub fn carry(from: &mut SerialLink, to: &mut SerialLink) -> Result<Duration, Box<dyn Error>> {
    let sent: Vec<u8> = (0..512u32).map(|number| (number * 7 % 256) as u8).collect();
    let (mut left, mut got) = (sent.as_slice(), Vec::new());
    let begin = now();
    while got.len() < sent.len() {
        ensure(now().saturating_since(begin) < LONG, || format!("{} of {} bytes came", got.len(), sent.len()))?;
        left = &left[from.try_write(left)?..];
        wait(Some(to), false, None, Duration::from_millis(5));
        let mut buffer = [0; 256];
        let count = to.try_read(&mut buffer)?;
        got.extend_from_slice(&buffer[..count]);
    }
    ensure(got == sent, || format!("other bytes came: {got:02x?}"))?;
    Ok(now().saturating_since(begin))
}

fn too_quick() -> Outcome {
    refused_rate(&adapter(HOST)?, TOO_QUICK, None)
}

fn liar() -> Outcome {
    // At its actual rate the port works.
    let link = SerialLink::open(&config(LIAR, LIAR_HAS, SLOW_CYCLE))?;
    ensure(link.baud() == LIAR_HAS, || format!("{} baud read back", link.baud()))?;
    drop(link);
    // The port keeps its rate.
    refused_rate(LIAR, LIAR_ASKED, Some(LIAR_HAS))
}

fn refused_rate(path: &str, asked: u32, has: Option<u32>) -> Outcome {
    match SerialLink::open(&config(path, asked, SLOW_CYCLE)) {
        Ok(link) => Err(format!("{path} was opened with {asked} baud and says that it has {}", link.baud()).into()),
        Err(error) => {
            let text = error.to_string();
            let SerialError::Baud { got, .. } = error else { return Err(text.into()) };
            ensure(has.is_none_or(|has| has == got), || format!("{got} baud read back"))?;
            let names_both = text.contains(&asked.to_string()) && text.contains(&got.to_string());
            ensure(names_both, || format!("a value is missing in: {text}"))?;
            Ok(text)
        }
    }
}

/// Must run before the first opening of the ports, while the adapters still delay bytes.
fn latency() -> Outcome {
    let [host, gateway] = [adapter(HOST)?, adapter(GATEWAY)?];
    let file = |path: &str| format!("/sys/bus/usb-serial/devices/{}/latency_timer", path.trim_start_matches("/dev/"));
    let timer = |path: &str| Ok::<u32, Box<dyn Error>>(fs::read_to_string(file(path))?.trim().parse()?);
    for path in [&host, &gateway] {
        // The default of a real adapter when it is plugged in.
        fs::write(file(path), "16")?;
    }
    let before = [timer(&host)?, timer(&gateway)?];
    ensure(before == [16; 2], || format!("timers of {before:?} ms at first"))?;
    let link = SerialLink::open(&config(&host, BAUDS[0], SLOW_CYCLE))?;
    ensure(*link.latency() == Latency::Low && link.warning().is_none(), || {
        format!("{:?}, {:?}", link.latency(), link.warning())
    })?;
    fs::set_permissions(&gateway, Permissions::from_mode(0o666))?;
    let of_nobody = as_user(User::Nobody, &["open", &gateway, &BAUDS[0].to_string()])?;
    ensure(of_nobody == "opened: Low", || format!("nobody: {of_nobody}"))?;
    let after = [timer(&host)?, timer(&gateway)?];
    ensure(after == [1; 2], || format!("timers of {after:?} ms after all"))?;
    Ok(format!("timers of {before:?} ms before, {after:?} ms after"))
}

fn exclusive(path: &str) -> Outcome {
    fs::set_permissions(path, Permissions::from_mode(0o666))?;
    let config = config(path, LIAR_HAS, SLOW_CYCLE);
    let baud = LIAR_HAS.to_string();
    let args = ["open", path, &baud];
    let first = SerialLink::open(&config)?;
    let refusal = match SerialLink::open(&config) {
        Ok(_) => return Err("opened twice in one program".into()),
        Err(error @ SerialError::InUse { .. }) => error.to_string(),
        Err(error) => return Err(format!("another refusal: {error}").into()),
    };
    for user in [User::Root, User::Nobody, User::Root] {
        let output_text = as_user(user, &args)?;
        ensure(output_text == format!("refused: {refusal}"), || format!("{user:?}: {output_text}"))?;
    }
    // Programs without a lock are refused by the kernel, and a refused program must not have changed that.
    let output_text = as_user(User::Nobody, &["read", path])?;
    ensure(output_text == "ResourceBusy", || format!("another kind of program: {output_text}"))?;
    drop(first);
    let output_text = as_user(User::Nobody, &args)?;
    ensure(output_text.starts_with("opened"), || format!("after it was closed: {output_text}"))?;
    Ok(refusal)
}

/// Prints the result of opening a file, as any program opens it.
pub fn try_to_read(path: &str) {
    match fs::File::open(path) {
        Ok(_) => println!("opened"),
        Err(error) => println!("{:?}", error.kind()),
    }
}

/// Prints the result of opening a port.
pub fn try_to_open(path: &str, baud: &str) {
    let opened = SerialLink::open(&config(path, baud.parse().unwrap_or_default(), SLOW_CYCLE));
    match opened {
        Ok(link) => println!("opened: {:?}", link.latency()),
        Err(error) => println!("refused: {error}"),
    }
}
