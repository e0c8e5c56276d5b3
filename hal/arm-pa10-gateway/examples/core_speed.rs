//! The computing time of a gateway core per host cycle: one command of the host, and five exchanges with the controller.
#![allow(clippy::print_stdout, reason = "prints its figures")]

use std::error::Error;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, AxisReply, AxisStatus, CommStatus, CommWord, ControlMessage, ControlPacket, ReplyMessage,
    ReplyPacket, ServoWord, SpeedCounts, TorqueCounts, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, DriveCommand, DriveMode, Firmware, GatewayState, Hello, HostMessage, MotionLimits,
};
use pb3dp_geometry::MonotonicTime;

const FORMAT: WireFormat = WireFormat::BigEndian6x10;
const HOST_CYCLES: u32 = 20_000;
const ROUNDS: u32 = 9;

struct Scene {
    gateway: Gateway,
    now: MonotonicTime,
    sequence: u16,
}

impl Scene {
    fn new() -> Result<Self, Box<dyn Error>> {
        let now = MonotonicTime::from_nanos(1_000_000_000);
        let firmware = Firmware::new("cost").ok_or("a name")?;
        let gateway = Gateway::new(GatewayConfig::new(ArmId(1), FORMAT, firmware, MotionLimits::WIDEST), now)?;
        Ok(Self { gateway, now, sequence: 0 })
    }

    fn say(&mut self, message: &HostMessage) {
        self.sequence = self.sequence.wrapping_add(1);
        let frame = message.frame(ArmId(1), self.sequence, self.now.as_nanos() / 1000);
        self.gateway.handle_host_bytes(self.now, &frame.encode());
        while self.gateway.poll_host_output(self.now).is_some() {}
    }

    /// The exchanges of one host cycle.
    fn exchange(&mut self) -> Result<(), Box<dyn Error>> {
        for _ in 0..5 {
            self.now = self.now.max(self.gateway.next_deadline());
            if let Some(frame) = self.gateway.poll_bus_frame(self.now) {
                let asked = ControlPacket::decode(FORMAT, arcnet::decode(Route::TO_CONTROLLER, &frame)?)?;
                let message = match asked.message {
                    ControlMessage::Cyclic(_) => ReplyMessage::Cyclic(reply()),
                    other => ReplyMessage::Done(other.letter()),
                };
                let packet = ReplyPacket { sequence: asked.sequence, message }.encode(FORMAT)?;
                self.gateway.handle_bus_frame(self.now, &arcnet::encode(Route::TO_HOST, &packet)?);
            }
            while self.gateway.poll_host_output(self.now).is_some() {}
        }
        Ok(())
    }

    fn follow(&mut self, speed_urad_per_s: i32) -> Result<(), Box<dyn Error>> {
        self.say(&HostMessage::Command(DriveCommand {
            mode: DriveMode::Follow,
            speed_urad_per_s: [speed_urad_per_s; 7],
        }));
        self.exchange()
    }

    fn lead_to_moving(&mut self) -> Result<(), Box<dyn Error>> {
        for _ in 0..40 {
            self.exchange()?;
        }
        self.say(&HostMessage::Hello(Hello { cycle_us: 10_000, limits: MotionLimits::WIDEST }));
        self.say(&HostMessage::Control(Control::Arm(ArmOperation::Start)));
        self.exchange()?;
        for _ in 0..40 {
            self.follow(0)?;
        }
        self.follow(1000)?;
        let status = self.gateway.status();
        if status.state == GatewayState::Moving { Ok(()) } else { Err(format!("{status:?}").into()) }
    }

    /// Mean time of a host cycle.
    fn measure(&mut self) -> Result<Duration, Box<dyn Error>> {
        let begin = Instant::now();
        for cycle in 0..HOST_CYCLES {
            // Speeds that rise and fall by a few counts.
            self.follow(100_000 + i32::try_from(cycle % 50)? * 1000)?;
        }
        Ok(begin.elapsed() / HOST_CYCLES)
    }
}

fn reply() -> ArmReply {
    let axis = AxisReply {
        status: AxisStatus::Servo(ServoWord(0)),
        angle: AngleCounts(1000),
        speed: Some(SpeedCounts(0)),
        torque: TorqueCounts(0),
    };
    ArmReply { axes: [axis; 7], comm: CommStatus::Comm(CommWord(1)) }
}

fn median(measure: impl Fn() -> Result<Duration, Box<dyn Error>>) -> Result<Duration, Box<dyn Error>> {
    let mut times = (0..ROUNDS).map(|_| measure()).collect::<Result<Vec<_>, _>>()?;
    times.sort();
    Ok(times[times.len() / 2])
}

fn main() -> Result<(), Box<dyn Error>> {
    let measure = || {
        let mut scene = Scene::new()?;
        scene.lead_to_moving()?;
        scene.measure()
    };
    let time = median(measure)?;
    let share = 100.0 * time.as_secs_f64() / 0.01;
    println!("one command and five exchanges: {time:?}, {share:.3} % of a host cycle of 10 ms");
    Ok(())
}
