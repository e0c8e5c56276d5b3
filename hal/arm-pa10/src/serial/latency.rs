//! Latency timer of serial adapters.

use std::os::fd::BorrowedFd;
use std::path::{Path, PathBuf};

use rustix::ioctl::{Getter, Opcode, Setter, ioctl};

/// From Linux's `asm-generic/ioctls.h`.
const TIOCGSERIAL: Opcode = 0x541E;
const TIOCSSERIAL: Opcode = 0x541F;

/// From Linux's `linux/tty_flags.h`: pass bytes on at once.
const ASYNC_LOW_LATENCY: i32 = 1 << 13;

/// Value for adjustable timers, ms.
const TIMER_MS: u32 = 1;

/// `struct serial_struct` from Linux's `linux/serial.h`.
#[repr(C)]
#[derive(Clone, Copy)]
struct SerialStruct {
    kind: i32,
    line: i32,
    port: u32,
    irq: i32,
    flags: i32,
    xmit_fifo_size: i32,
    custom_divisor: i32,
    baud_base: i32,
    close_delay: u16,
    io_type: u8,
    reserved: u8,
    hub6: i32,
    closing_wait: u16,
    closing_wait2: u16,
    iomem_base: *mut u8,
    iomem_reg_shift: u16,
    port_high: u32,
    iomap_base: usize,
}

/// Whether a port passes bytes on at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Latency {
    /// The low-latency flag is set.
    Low,
    /// The adapter buffers bytes for this time, ms.
    Timer {
        /// Value read back.
        millis: u32,
    },
    /// Not an adapter: nothing buffers bytes.
    NotUsb,
    /// An adapter whose timer is unknown.
    Unknown,
}

impl Latency {
    /// Advice for the operator, if necessary.
    pub(super) fn warning(&self, port: &str) -> Option<String> {
        match self {
            Self::Low | Self::NotUsb => None,
            Self::Timer { millis } if *millis <= TIMER_MS => None,
            Self::Timer { millis } => Some(format!(
                "serial port {port}: its adapter delays bytes by {millis} ms, and this user may not change the latency \
                 timer; as root: echo {TIMER_MS} > {}",
                timer(port).display()
            )),
            Self::Unknown => Some(format!(
                "serial port {port}: the latency timer of its adapter is unknown; the warm-up measures the delay"
            )),
        }
    }
}

/// Makes the port pass on bytes at once, if possible.
pub(super) fn lower(fd: BorrowedFd<'_>, path: &str) -> Latency {
    if set_low_latency(fd) {
        return Latency::Low;
    }
    let timer = timer(path);
    // The value is read back.
    let _ = std::fs::write(&timer, TIMER_MS.to_string());
    let millis = std::fs::read_to_string(&timer).ok().and_then(|text| text.trim().parse().ok());
    match millis {
        Some(millis) => Latency::Timer { millis },
        None if is_usb(path) => Latency::Unknown,
        None => Latency::NotUsb,
    }
}

/// Sets the flag and reads it back. Pseudo-terminals and some drivers do not know it.
fn set_low_latency(fd: BorrowedFd<'_>) -> bool {
    // SAFETY: TIOCGSERIAL fills a `serial_struct`, whose fields are plain numbers.
    let get = || unsafe { ioctl(fd, Getter::<TIOCGSERIAL, SerialStruct>::new()) };
    let Ok(mut settings) = get() else { return false };
    settings.flags |= ASYNC_LOW_LATENCY;
    // SAFETY: TIOCSSERIAL reads a `serial_struct`; this one differs from that of the driver in one flag.
    if unsafe { ioctl(fd, Setter::<TIOCSSERIAL, SerialStruct>::new(settings)) }.is_err() {
        return false;
    }
    get().is_ok_and(|settings| settings.flags & ASYNC_LOW_LATENCY != 0)
}

/// Value of the adapter's timer, if it has one.
fn timer(path: &str) -> PathBuf {
    Path::new("/sys/bus/usb-serial/devices").join(device(path)).join("latency_timer")
}

fn is_usb(path: &str) -> bool {
    let device = Path::new("/sys/class/tty").join(device(path)).join("device");
    // The folder is a link into the device tree, which names its buses.
    device.canonicalize().is_ok_and(|target| target.to_string_lossy().contains("/usb"))
}

/// `ttyUSB0` of `/dev/ttyUSB0`, and of a link to it.
fn device(path: &str) -> PathBuf {
    let target = Path::new(path).canonicalize().unwrap_or_else(|_| PathBuf::from(path));
    target.file_name().map_or_else(PathBuf::new, PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_is_that_of_the_kernel() {
        // From linux/serial.h on 64 bits: 8 ints, 2 short and 2 char, int, 2 shorts, pointer, short, int, long.
        #[cfg(target_pointer_width = "64")]
        {
            assert_eq!(size_of::<SerialStruct>(), 72);
            assert_eq!(std::mem::offset_of!(SerialStruct, hub6), 36);
            assert_eq!(std::mem::offset_of!(SerialStruct, iomem_base), 48);
            assert_eq!(std::mem::offset_of!(SerialStruct, iomap_base), 64);
        }
        assert_eq!(std::mem::offset_of!(SerialStruct, flags), 16);
    }

    #[test]
    fn only_what_keeps_bytes_back_is_warned_of() {
        for quiet in [Latency::Low, Latency::NotUsb, Latency::Timer { millis: 1 }] {
            assert_eq!(quiet.warning("/dev/ttyUSB7"), None, "{quiet:?}");
        }
        let warning = Latency::Timer { millis: 16 }.warning("/dev/ttyUSB7").unwrap();
        assert!(warning.contains("16 ms") && warning.contains("ttyUSB7/latency_timer"), "{warning}");
        assert!(Latency::Unknown.warning("/dev/ttyACM1").unwrap().contains("/dev/ttyACM1"));
    }
}
