//! The command `pb3dp run` in this computer.

use std::path::Path;
use std::time::Duration;

use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::names;
use pb3dp_setup::setup::read_setup;

use crate::images;
use crate::lines::name_port;
use crate::program::Running;
use crate::report::{Outcome, Report, ensure};
use crate::setup::{self, BUSES, DISCONNECT, HERE, control, name};
use crate::system::wait_for;
use crate::world::World;

/// Region of the target in the left image.
const REGION: &str = "rect:344,200,100,80";

/// Largest error of the hand.
const OFF_MAX_M: f64 = 0.005;
const TURNED_MAX_DEG: f64 = 2.0;

/// Tracking time before the hand pose is checked.
const TRACKED: Duration = Duration::from_millis(500);

/// Status line while the operator holds the hand.
const HOLDING: &str = "holding: both arms held by the operator";

/// The camera that is disconnected.
const PULLED: usize = 1;

/// Runs the checks and returns the world for the next ones.
pub fn check(report: &mut Report) -> Option<World> {
    report.check("the rig is there", || {
        images::prepare()?;
        setup::write()?;
        let setup = read_setup(Path::new(HERE))?;
        Ok(format!("{}, {}", name_port(&setup.rig.arms.vs, "ARM1")?, name_port(&setup.rig.arms.tc, "ARM2")?))
    });
    let mut rig = None;
    report.check("the program starts with cameras and arms", || {
        let (world, run) = start()?;
        rig = Some((world, run));
        Ok(String::new())
    });
    let (world, mut run) = rig?;
    report.check("the hand is led by the images, and stays before the target", || follow(&world, &mut run));
    report.check("a camera that is pulled and plugged in again: the hand holds, and continues on command", || {
        pulled(&world, &mut run)
    });
    report.check("the hand holds, and both arms stop in order", || end(&world, run));
    Some(world)
}

fn start() -> Result<(World, Running), Box<dyn std::error::Error>> {
    let world = World::start()?;
    wait_for("the first images are shown", || (world.shown() > 1).then_some(()))?;
    let words = ["run", "--config", HERE, "--operator", "console", "--region", REGION, "--out", "/out"];
    let mut run = Running::start(&words)?;
    run.wait_for("target initialised", None)?;
    Ok((world, run))
}

fn follow(world: &World, run: &mut Running) -> Outcome {
    run.wait_for("selecting: ", Some("select"))?;
    run.wait_for("approaching", Some("start"))?;
    run.wait_for("tracking", None)?;
    std::thread::sleep(TRACKED);
    place(world)
}

/// True error of the hand.
fn place(world: &World) -> Outcome {
    let (off_m, turned_deg) = world.hand_off();
    let text = format!("{:.1} mm and {turned_deg:.1} degrees from the desired pose", off_m * 1e3);
    ensure(off_m < OFF_MAX_M && turned_deg < TURNED_MAX_DEG, || text.clone())?;
    Ok(text)
}

fn pulled(world: &World, run: &mut Running) -> Outcome {
    let disconnect = control(DISCONNECT)?;
    // Closed before the program has noticed: the driver comes back when no process has it open.
    let node = names::open(&Linux, &name(PULLED))?.1;
    let _ = { node }.set_control(disconnect, 0);
    let lost = run.wait_for("trying to reopen", None)?;
    ensure(lost.contains(BUSES[PULLED]), || format!("the program printed: {lost}"))?;
    let rests = run.wait_for("check the cameras", None)?;
    run.wait_for("tracking", Some("resume"))?;
    Ok(format!("{rests}; then {}", place(world)?))
}

fn end(world: &World, mut run: Running) -> Outcome {
    run.say("hold")?;
    // The program prints this line by itself only after a motion.
    let holding = run.wait_for(HOLDING, Some("status"))?;
    run.say("quit")?;
    let status = run.end()?;
    ensure(status.success(), || format!("the run ended with {status}"))?;
    for arm in world.arms() {
        ensure(arm.is_braked, || format!("the brakes of an arm are open: {arm}"))?;
    }
    Ok(holding)
}
