//! A step of the supervisor never allocates.

use crate::supervisor::bench::{Bench, config};
use pb3dp_allocation_count::requests;
use pb3dp_servo::supervisor::{ArmCondition, OperatorCommand, Supervisor};

#[test]
fn steps_do_not_allocate() {
    let mut bench = Bench::following(config());
    let before = requests();
    bench.run(1.0);
    for command in [
        OperatorCommand::Hold,
        OperatorCommand::HoldHand,
        OperatorCommand::Resume,
        OperatorCommand::Select,
        OperatorCommand::Start,
        OperatorCommand::Stop,
        OperatorCommand::Reset,
    ] {
        bench.say(command);
        bench.run(0.5);
    }
    assert_eq!(requests() - before, 0);
    bench.begin();
    bench.lie(|i| i.arms[0].state = ArmCondition::Fault);
    let before = requests();
    bench.run(0.1);
    assert!(bench.state().is_latched());
    assert_eq!(requests() - before, 0);
    let probe = requests();
    drop(std::hint::black_box(Box::new([0u8; 64])));
    assert!(requests() > probe, "the allocation counter works");
    assert!(std::mem::size_of::<Supervisor>() < 32_768, "small enough for any stack");
}
