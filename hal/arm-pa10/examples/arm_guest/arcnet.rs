//! The bus through the kernel's own ARCNET driver: refusals and their reasons, frames in both directions, a bus that accepts
//! nothing.

use std::error::Error;
use std::fs;
use std::time::Duration;

use pb3dp_arm_pa10_gateway::bus::{ArcnetError, ArcnetSocket, BusPort, FRAME_ROOM};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{Packet, WireFormat};
use pb3dp_hal_platform::realtime::now;

use crate::card::{Card, Frame, module_parameters};
use crate::report::{Outcome, Report, ensure};
use crate::system::{User, as_user, load, wait_for};

const NAME: &str = "arc0";

/// The driver of the card, which this program loads.
const DRIVER: &str = "arc_rimi";

/// ARPHRD_ARCNET and the length of an address, as the driver must report them.
const KIND: &str = "7";
const ADDRESS_LENGTH: &str = "1";

/// More frames than the kernel queues for a card.
const TAKEN_MAX: u32 = 100_000;

pub fn check(report: &mut Report) {
    report.check("an interface that is not there is named", || refused(&missing()));
    report.check("the driver's interface is an ARCNET, and is named while it is down", appears);
    report.check("it is opened by one program, and not by a user without the right", opens);
    report.check("frames go out as the card takes them, in both formats", frames_out);
    report.check("frames come in as the card gives them, in both formats", frames_in);
    report.check("a bus that takes nothing holds nobody up", full);
}

fn missing() -> ArcnetError {
    ArcnetError::Missing { name: NAME.into() }
}

fn refused(expected: &ArcnetError) -> Outcome {
    match ArcnetSocket::open(NAME) {
        Ok(_) => Err("it was opened".into()),
        Err(error) if error == *expected => Ok(error.to_string()),
        Err(error) => Err(format!("`{error}` instead of `{expected}`").into()),
    }
}

fn about(what: &str) -> Result<String, Box<dyn Error>> {
    let path = format!("/sys/class/net/{NAME}/{what}");
    let text = fs::read_to_string(&path).map_err(|error| format!("{path}: {error}"))?;
    Ok(text.trim().to_owned())
}

/// The interface is never set down again: without its own function for that, arc_rimi makes the kernel (6.1) call address 0.
fn switch_on() -> Result<(), Box<dyn Error>> {
    let flags = u32::from_str_radix(about("flags")?.trim_start_matches("0x"), 16)?;
    fs::write(format!("/sys/class/net/{NAME}/flags"), format!("{:#x}", flags | libc::IFF_UP as u32))?;
    // The driver reports the carrier after a second without a new token.
    wait_for("the bus is there", || about("carrier").is_ok_and(|carrier| carrier == "1").then_some(()))
}

fn appears() -> Outcome {
    load(DRIVER, &module_parameters(NAME))?;
    let (kind, length) = (about("type")?, about("addr_len")?);
    ensure(kind == KIND && length == ADDRESS_LENGTH, || format!("type {kind}, address of {length} bytes"))?;
    let why = refused(&ArcnetError::Down { name: NAME.into() })?;
    Ok(format!("type {kind}, address {}; {why}", about("address")?))
}

fn opens() -> Outcome {
    switch_on()?;
    let of_nobody = as_user(User::Nobody, &["open-bus", NAME])?;
    ensure(of_nobody == format!("refused: {}", ArcnetError::Permission), || format!("nobody: {of_nobody}"))?;
    let first = ArcnetSocket::open(NAME)?;
    let in_use = ArcnetError::InUse { name: NAME.into() };
    refused(&in_use)?;
    let of_other = as_user(User::Root, &["open-bus", NAME])?;
    ensure(of_other == format!("refused: {in_use}"), || format!("another program: {of_other}"))?;
    drop(first);
    let of_other = as_user(User::Root, &["open-bus", NAME])?;
    ensure(of_other == "opened", || format!("after it was closed: {of_other}"))?;
    Ok(in_use.to_string())
}

/// Node numbers of the published drivers for the controller (SDU, Orca, RobWork).
const HOST: u8 = 0xFF;
const CONTROLLER: u8 = 0xFE;

/// A packet as long as a command or a reply, with many different byte values.
fn packet(length: usize) -> Result<Packet, Box<dyn Error>> {
    let bytes: Vec<u8> = (0..length).map(|number| (number * 37 + 11) as u8).collect();
    Packet::from_slice(&bytes).ok_or_else(|| "a packet that is too long".into())
}

/// The packet of a cyclic message has a sequence number and a letter before its data.
fn lengths(format: WireFormat) -> [usize; 2] {
    [2 + format.command_length(), 2 + format.reply_length()]
}

fn frames_out() -> Outcome {
    let card = Card::open()?;
    let mut port = ArcnetSocket::open(NAME)?;
    let mut figures = Vec::new();
    for format in WireFormat::ALL {
        card.clear()?;
        let packet = packet(lengths(format)[0])?;
        let sent = arcnet::encode(Route::TO_CONTROLLER, &packet)?;
        ensure(port.try_send(&sent)?, || "there is no room for a frame".into())?;
        let found = wait_for("a frame is in the card", || card.frames().ok()?.into_iter().next())?;
        // The sender is not visible, because its byte is the status register; a real card sets the sender itself.
        ensure(found.receiver == CONTROLLER && found.data == *packet, || {
            format!("sent {:02x?} to {CONTROLLER:#x}, in the card is {found:02x?}", packet.as_slice())
        })?;
        // The driver computes the pointer again.
        ensure(sent.get(2) == Some(&found.pointer), || format!("sent {:02x?}, in the card is {found:02x?}", &*sent))?;
        card.has_sent()?;
        figures.push(format!("{} bytes, pointer {}", found.data.len(), found.pointer));
    }
    Ok(figures.join("; "))
}

fn frames_in() -> Outcome {
    let card = Card::open()?;
    let mut port = ArcnetSocket::open(NAME)?;
    let mut figures = Vec::new();
    for format in WireFormat::ALL {
        card.clear()?;
        let sent = packet(lengths(format)[1])?;
        card.put(&Frame::new(CONTROLLER, HOST, &sent))?;
        let got = wait_for("the frame comes in", || {
            card.has_received().ok()?;
            let mut buffer = [0; FRAME_ROOM];
            while let Some(count) = port.try_receive(&mut buffer).ok()? {
                // The first buffer, whose header is the registers, has an invalid frame.
                if let Ok(packet) = arcnet::decode(Route::TO_HOST, &buffer[..count]) {
                    return Some(packet.to_vec());
                }
            }
            None
        })?;
        ensure(got == *sent, || format!("in the card {:02x?}, received {got:02x?}", sent.as_slice()))?;
        // Other buffers contained the same frame.
        while port.try_receive(&mut [0; FRAME_ROOM])?.is_some() {}
        figures.push(format!("{} bytes", got.len()));
    }
    Ok(figures.join("; "))
}

/// As on a bus whose other nodes are off: the card never reports that it has sent.
fn full() -> Outcome {
    let card = Card::open()?;
    let mut port = ArcnetSocket::open(NAME)?;
    let frame = arcnet::encode(Route::TO_CONTROLLER, &packet(lengths(WireFormat::ALL[0])[0])?)?;
    let (mut taken, mut longest) = (0, Duration::ZERO);
    loop {
        let before = now();
        let is_taken = port.try_send(&frame)?;
        longest = longest.max(now().saturating_since(before));
        if !is_taken {
            break;
        }
        taken += 1;
        ensure(taken < TAKEN_MAX, || format!("{taken} frames were taken, and none has left"))?;
    }
    wait_for("frames are taken again when the card has sent", || {
        card.has_sent().ok()?;
        port.try_send(&frame).ok()?.then_some(())
    })?;
    Ok(format!("{taken} frames are taken, then none without an error; a call takes {longest:?} at most"))
}

/// Prints the result of opening an interface.
pub fn try_to_open(interface: &str) {
    match ArcnetSocket::open(interface) {
        Ok(_) => println!("opened"),
        Err(error) => println!("refused: {error}"),
    }
}
