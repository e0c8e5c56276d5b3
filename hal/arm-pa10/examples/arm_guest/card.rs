//! An ARCNET card of plain memory: the kernel's driver arc_rimi uses a memory range as the card, which this program reads and
//! writes as the bus would.
//!
//! Layout (Linux, drivers/net/arcnet/arc-rimi.c and com9026.h): from 0x800 four buffers of 512 bytes; the first two bytes are
//! also the registers of status and command. A short frame is sender, receiver, a pointer and an unused byte; its data end at
//! byte 256 and begin at the pointer. The interrupt is that of an unused serial port.

use std::error::Error;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::time::Duration;

use pb3dp_hal_platform::realtime::{now, sleep_until};

/// As on the kernel's command line.
const MEMORY: u64 = 0x1000_0000;
const BUFFERS: u64 = MEMORY + 0x800;
const BUFFER_LENGTH: usize = 512;
const BUFFER_COUNT: usize = 4;

/// The data of a short frame ends here.
const SHORT_END: usize = 256;

/// The second serial port (16550), and its interrupt.
const BELL: u64 = 0x2F8;
const BELL_LINE: u32 = 3;
/// Registers of a 16550: interrupt enable and interrupt identification.
const INTERRUPTS_WANTED: u64 = BELL + 1;
const INTERRUPT_IS: u64 = BELL + 2;
const WHEN_EMPTY: u8 = 2;

/// Bits of the status.
const RECEIVED: u8 = 0x80;
const SENT: u8 = 0x01;
const ACKNOWLEDGED: u8 = 0x02;

/// Parameters of the driver.
pub fn module_parameters(interface: &str) -> String {
    format!("io={MEMORY:#x} irq={BELL_LINE} node=0x42 device={interface}")
}

/// A short frame in a buffer.
#[derive(Debug)]
pub struct Frame {
    pub sender: u8,
    pub receiver: u8,
    /// Offset of the data.
    pub pointer: u8,
    pub data: Vec<u8>,
}

impl Frame {
    /// The pointer follows from the length of the data.
    pub fn new(sender: u8, receiver: u8, data: &[u8]) -> Self {
        let pointer = (SHORT_END - data.len()) as u8;
        Self { sender, receiver, pointer, data: data.to_vec() }
    }
}

/// The card, seen from the bus.
pub struct Card {
    memory: File,
    ports: File,
}

impl Card {
    pub fn open() -> Result<Self, Box<dyn Error>> {
        let open = |path: &str| {
            let file = OpenOptions::new().read(true).write(true).open(path);
            file.map_err(|error| format!("{path}: {error}"))
        };
        Ok(Self { memory: open("/dev/mem")?, ports: open("/dev/port")? })
    }

    /// Short frames in the buffers: those with a pointer.
    pub fn frames(&self) -> Result<Vec<Frame>, Box<dyn Error>> {
        let mut frames = Vec::new();
        for index in 0..BUFFER_COUNT {
            let mut buffer = [0; BUFFER_LENGTH];
            self.memory.read_exact_at(&mut buffer, address(index))?;
            let [sender, receiver, pointer, ..] = buffer;
            if pointer != 0 {
                let data = buffer[usize::from(pointer)..SHORT_END].to_vec();
                frames.push(Frame { sender, receiver, pointer, data });
            }
        }
        Ok(frames)
    }

    /// Clears the buffers except for the registers.
    pub fn clear(&self) -> Result<(), Box<dyn Error>> {
        for index in 0..BUFFER_COUNT {
            self.memory.write_all_at(&[0; BUFFER_LENGTH - 2], address(index) + 2)?;
        }
        Ok(())
    }

    /// Puts a frame into each buffer except the first, whose header is the registers.
    pub fn put(&self, frame: &Frame) -> Result<(), Box<dyn Error>> {
        let Frame { sender, receiver, pointer, data } = frame;
        for index in 1..BUFFER_COUNT {
            self.memory.write_all_at(&[*sender, *receiver, *pointer, 0], address(index))?;
            self.memory.write_all_at(data, address(index) + u64::from(*pointer))?;
        }
        Ok(())
    }

    /// The card reports that a frame was sent and acknowledged.
    pub fn has_sent(&self) -> Result<(), Box<dyn Error>> {
        self.interrupt(SENT | ACKNOWLEDGED)
    }

    /// The card reports that a frame was received.
    pub fn has_received(&self) -> Result<(), Box<dyn Error>> {
        self.interrupt(RECEIVED)
    }

    fn interrupt(&self, status: u8) -> Result<(), Box<dyn Error>> {
        self.memory.write_all_at(&[status], BUFFERS)?;
        self.ports.write_all_at(&[WHEN_EMPTY], INTERRUPTS_WANTED)?;
        // The interrupt occurs before the next call ends, or never.
        sleep_until(now() + Duration::from_millis(2));
        self.ports.read_exact_at(&mut [0], INTERRUPT_IS)?;
        self.ports.write_all_at(&[0], INTERRUPTS_WANTED)?;
        Ok(())
    }
}

fn address(index: usize) -> u64 {
    BUFFERS + (index * BUFFER_LENGTH) as u64
}
