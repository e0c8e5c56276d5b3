//! Records under attack, in virtual time: what comes out is what the owner sent, in order and once.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use pb3dp_arm_pa10::arm::KeyedLink;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Agreement, ArmId, DriveCommand, DriveMode, Hello, HostMessage, MotionLimits, SharedKey, Side,
};
use pb3dp_hal_platform::transport::{ByteLink, Symptom, Unplugged};
use pb3dp_test_support::sweep;

const ARM: ArmId = ArmId(2);

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) as usize % most.max(1)
    }
}

/// A line whose input is given, and whose output is kept.
#[derive(Debug, Default)]
struct Memory {
    input: Vec<u8>,
    output: Vec<u8>,
}

impl ByteLink for Memory {
    fn name(&self) -> &str {
        "memory"
    }
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        let count = buffer.len().min(self.input.len());
        buffer[..count].copy_from_slice(&self.input[..count]);
        self.input.drain(..count);
        Ok(count)
    }
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.output.extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn fd(&self) -> Option<std::os::fd::BorrowedFd<'_>> {
        None
    }
}

fn agreement(connection: u8) -> Agreement {
    Agreement::new(SharedKey::new(&[9; 32]).unwrap(), ARM, [connection; 32], [7; 32])
}

/// The frames of an owner that moves an arm.
fn frames() -> Vec<Vec<u8>> {
    let hello = HostMessage::Hello(Hello { cycle_us: 10_000, limits: MotionLimits::WIDEST });
    let follow =
        |speed: i32| HostMessage::Command(DriveCommand { mode: DriveMode::Follow, speed_urad_per_s: [speed; 7] });
    let messages = [hello, HostMessage::Heartbeat, follow(0), follow(100_000), follow(200_000), follow(0)];
    let numbered = messages.iter().zip(0u16..);
    numbered.map(|(message, number)| message.frame(ARM, number, 10_000 * u64::from(number)).encode().to_vec()).collect()
}

fn sealed(connection: u8, side: Side) -> Vec<Vec<u8>> {
    let (mut sealer, _) = agreement(connection).records(side);
    frames().iter().map(|frame| sealer.seal(frame).to_vec()).collect()
}

/// An attack on a connection: captured records, changed.
fn attack(random: &mut Random, capture: &[Vec<u8>]) -> Vec<u8> {
    let mut pick = |most: usize| random.below(most);
    let mut records = capture.to_vec();
    match pick(6) {
        0 => {
            let (record, at) = (pick(records.len()), pick(64));
            let at = at.min(records[record].len() - 1);
            records[record][at] ^= 1 << pick(8);
        }
        1 => {
            let (one, other) = (pick(records.len()), pick(records.len()));
            records.swap(one, other);
        }
        2 => {
            let again = records[pick(records.len())].clone();
            let at = pick(records.len());
            records.insert(at, again);
        }
        3 => drop(records.remove(pick(capture.len()))),
        4 => {
            let record = pick(records.len());
            let length = pick(records[record].len());
            records[record].truncate(length);
        }
        _ => {
            let bytes = (0..pick(200)).map(|_| pick(256) as u8).collect();
            records = vec![bytes];
        }
    }
    records.concat()
}

#[test]
fn nothing_but_the_owners_frames_comes_out() {
    let rounds = sweep(20_000, 1_000_000);
    let mut random = Random(5);
    let owner: Vec<u8> = frames().concat();
    let captures = [sealed(1, Side::Host), sealed(2, Side::Host), sealed(1, Side::Gateway)];
    let mut broken = 0;
    for round in 0..rounds {
        let capture = &captures[if random.below(2) == 0 { 0 } else { round % 3 }];
        let input = attack(&mut random, capture);
        let mut link = KeyedLink::new(Memory { input, ..Memory::default() }, &agreement(1), Side::Gateway);
        let (mut out, mut buffer) = (Vec::new(), [0; 512]);
        loop {
            match link.try_read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => out.extend_from_slice(&buffer[..count]),
                Err(gone) => {
                    assert_eq!(gone.symptom, Symptom::NotAuthentic);
                    broken += 1;
                    break;
                }
            }
        }
        assert!(owner.starts_with(&out), "round {round}: something that the owner did not send");
    }
    assert!(broken > rounds / 2, "{broken} of {rounds}");
}

/// Frames go through in both directions, for readers with small buffers too.
#[test]
fn a_link_carries_frames_in_both_directions() {
    let mut host = KeyedLink::new(Memory::default(), &agreement(1), Side::Host);
    for frame in frames() {
        assert_eq!(host.try_write(&frame).unwrap(), frame.len());
    }
    let written = sealed(1, Side::Host).concat();
    for size in [1, 19, 64, 512] {
        let memory = Memory { input: written.clone(), ..Memory::default() };
        let mut gateway = KeyedLink::new(memory, &agreement(1), Side::Gateway);
        let (mut out, mut buffer) = (Vec::new(), vec![0; size]);
        while out.len() < frames().concat().len() {
            let count = gateway.try_read(&mut buffer).unwrap();
            assert!(count > 0, "size {size}: a record that has come waits for the next read");
            out.extend_from_slice(&buffer[..count]);
        }
        assert_eq!(out, frames().concat(), "{size}");
    }
}
