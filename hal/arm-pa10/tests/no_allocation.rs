//! The cycle of driver, codec and link does not allocate on the heap.
#![allow(clippy::unwrap_used)] // In helpers of tests.

use pb3dp_allocation_count::requests;
use pb3dp_arm_pa10::driver::{DriverState, Reply, Request};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{ControlPacket, ReplyMessage, ReplyPacket, SequenceModulus, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, DriveCommand, DriveMode, FrameParser, GatewayState, HostMessage, Received,
};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, CYCLE, velocity};
use pb3dp_arm_pa10_test_support::gateway_bench;

#[test]
fn cycles_do_not_allocate() {
    let mut bench = Bench::in_state(DriverState::Moving);
    let mut parser = FrameParser::new(ArmId(1));
    let sample = bench.peer.sample();
    let before = requests();
    let mut frames = 0;
    for cycle in 0..1000u16 {
        bench.now = bench.now + CYCLE;
        let request = if cycle % 100 == 50 { Request::Hold } else { Request::Move(velocity()) };
        bench.driver.handle_request(bench.now, request).unwrap();
        let transmit = bench.driver.poll_transmit(bench.now).unwrap();
        for format in WireFormat::ALL {
            let sequence = SequenceModulus::Modulo128.reduce(transmit.exchange);
            let packet = ControlPacket { sequence, message: transmit.message }.encode(format).unwrap();
            let frame = arcnet::encode(Route::TO_CONTROLLER, &packet).unwrap();
            let bytes = arcnet::decode(Route::TO_CONTROLLER, &frame).unwrap();
            assert_eq!(ControlPacket::decode(format, bytes).unwrap().message, transmit.message);
        }
        let command = HostMessage::Command(DriveCommand::follow(&velocity()).unwrap());
        let bytes = command.frame(ArmId(1), cycle, 0).encode();
        parser.feed(&[0xA5, 0x5A, 0xFF], |_| {});
        parser.feed(&bytes, |received| frames += u32::from(matches!(received, Received::Frame(_))));
        bench.driver.handle_reply(bench.now, &Reply::Sample(sample));
    }
    assert_eq!(requests(), before);
    // The parser still waits for a few bytes after the last frames.
    assert!(frames >= 999, "{frames}");
    let probe = requests();
    drop(std::hint::black_box(Box::new([0u8; 64])));
    assert!(requests() > probe, "the counter counts");
}

#[test]
fn cycles_of_a_gateway_do_not_allocate() {
    let mut bench = gateway_bench::Bench::new();
    bench.lead_to(GatewayState::Moving);
    let format = bench.controller.format;
    let message = ReplyMessage::Cyclic(bench.controller.arm_reply(format));
    let messages = [
        bench.command(DriveMode::Follow, velocity()),
        HostMessage::Heartbeat,
        gateway_bench::control(ArmOperation::Start),
    ];
    let mut gateway = bench.gateway.clone();
    let (mut now, mut sequence, mut answers) = (bench.now, bench.sequence, 0);
    let before = requests();
    for cycle in 0..5000u32 {
        now = now + gateway_bench::CYCLE;
        if let Some(frame) = gateway.poll_bus_frame(now) {
            let asked = arcnet::decode(Route::TO_CONTROLLER, &frame).unwrap();
            let reply = ReplyPacket { sequence: asked[0], message }.encode(format).unwrap();
            gateway.handle_bus_frame(now, &arcnet::encode(Route::TO_HOST, &reply).unwrap());
        }
        if cycle.is_multiple_of(5) && cycle < 4000 {
            for message in &messages {
                sequence = sequence.wrapping_add(1);
                let frame = message.frame(gateway_bench::ARM, sequence, now.as_nanos() / 1000 + bench.host_clock_us);
                gateway.handle_host_bytes(now, &frame.encode());
            }
        }
        while gateway.poll_host_output(now).is_some() {
            answers += 1;
        }
    }
    assert_eq!(requests(), before);
    // All answers, and the FAULT of the silence at the end.
    assert_eq!((answers, gateway.status().state), (3 * 800 + 1, GatewayState::Fault));
}
