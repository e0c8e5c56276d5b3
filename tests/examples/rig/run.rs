//! The command `pb3dp run` in this computer, with a script in the place of the person at its panel.

use std::error::Error;
use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::names;
use pb3dp_cell::interruption::INTERRUPTED;
use pb3dp_setup::setup::read_setup;
use serde_json::{Value, json};

use crate::client::Client;
use crate::images;
use crate::lines::name_port;
use crate::program::Running;
use crate::report::{Outcome, Report, ensure};
use crate::setup::{self, DISCONNECT, Devices, HERE, control, name};
use crate::system::wait_for;
use crate::world::World;

/// Region of the target in the left image.
const REGION: &str = "rect:344,200,100,80";

/// Largest error of the hand.
const OFF_MAX_M: f64 = 0.005;
const TURNED_MAX_DEG: f64 = 2.0;

/// Tracking time before the hand pose is checked.
const TRACKED: Duration = Duration::from_millis(500);

/// Anything that is to happen happens within this time of this slow computer.
const TIMEOUT: Duration = Duration::from_secs(40);

/// Address of the panel.
const PANEL: ([u8; 4], u16) = ([127, 0, 0, 1], 8087);

/// Runs the checks and returns the world for the next ones.
pub fn check(devices: Devices, report: &mut Report) -> Option<World> {
    report.check("the rig is there", || {
        images::prepare(devices)?;
        setup::write(devices)?;
        let setup = read_setup(Path::new(HERE))?;
        Ok(format!("{}, {}", name_port(&setup.rig.arms.vs, "ARM1")?, name_port(&setup.rig.arms.tc, "ARM2")?))
    });
    let mut rig = None;
    report.check("the program starts with cameras and arms", || {
        rig = Some(start(devices)?);
        Ok(String::new())
    });
    let (world, mut run, person) = rig?;
    report.check("the object is chosen in the live image", || select(&person));
    report.check("the hand is led by the images, and stays before the target", || follow(&world, &person));
    report.check("a camera that is pulled and plugged in again: the hand holds, and follows again", || {
        pulled(devices, &world, &mut run, &person)
    });
    report.check("the hand holds, and both arms stop in order", || end(&world, run, person));
    Some(world)
}

/// Starts the program with its panel; a script takes the command, as a person at the page does.
fn start(devices: Devices) -> Result<(World, Running, Client), Box<dyn Error>> {
    let world = World::start(devices)?;
    wait_for("the first images are shown", || (world.shown() > 1).then_some(()))?;
    loopback_up()?;
    let address = SocketAddr::from(PANEL);
    let mut run = Running::start(&["run", "--config", HERE, "--panel", &address.to_string(), "--out", "/out"])?;
    run.wait_for("is the operator panel", None)?;
    let mut person = Client::new(address);
    person.patience = TIMEOUT;
    person.wait_for("images", |state| state["images"]["sequence"].is_u64());
    person.take("script");
    person.keep_alive();
    Ok((world, run, person))
}

/// Brings the interface up over which programs of this computer speak to each other.
fn loopback_up() -> Result<(), Box<dyn Error>> {
    const UP: u32 = 1;
    Ok(fs::write("/sys/class/net/lo/flags", format!("{UP:#x}"))?)
}

fn select(person: &Client) -> Outcome {
    let preview = person.post("preview", &json!({ "region": REGION }).to_string());
    let preview_json = preview.json();
    ensure(preview.status == 200 && preview_json["will_work"] == true, || format!("the preview is {}", preview.body))?;
    command(person, "select", json!({ "region": REGION }))?;
    person.wait_for("a target that the hand can follow", |state| {
        state["state"]["name"] == "selecting" && state["state"]["is_ready"] == true
    });
    Ok(format!("region {REGION} {}", preview_json["why"].as_str().unwrap_or_default()).trim_end().to_owned())
}

/// A command for the state as the script saw it; it must be accepted.
fn command(person: &Client, name: &str, mut body: Value) -> Result<(), Box<dyn Error>> {
    body["seen"] = person.shown_state();
    let reply = person.post(name, &body.to_string());
    ensure(reply.status == 200, || format!("{name}: {}", reply.body))
}

fn wait_for_state(person: &Client, name: &str) -> Value {
    person.wait_for(name, |state| state["state"]["name"] == name)
}

fn follow(world: &World, person: &Client) -> Outcome {
    command(person, "start", json!({}))?;
    let tracking = wait_for_state(person, "tracking");
    std::thread::sleep(TRACKED);
    Ok(format!("{}; {}", tracking["why"]["line"].as_str().unwrap_or("tracking"), place(world)?))
}

/// True error of the hand.
fn place(world: &World) -> Outcome {
    let (off_m, turned_deg) = world.hand_off();
    let text = format!("{:.1} mm and {turned_deg:.1} degrees from the desired pose", off_m * 1e3);
    ensure(off_m < OFF_MAX_M && turned_deg < TURNED_MAX_DEG, || text.clone())?;
    Ok(text)
}

fn pulled(devices: Devices, world: &World, run: &mut Running, person: &Client) -> Outcome {
    let last = devices.buses().len() - 1;
    let disconnect = control(DISCONNECT)?;
    // Closed before the program has noticed: the driver comes back when no process has it open.
    let node = names::open(&Linux, &name(last))?.1;
    let _ = { node }.set_control(disconnect, 0);
    let lost = run.wait_for("trying to reopen", None)?;
    ensure(lost.contains(devices.buses()[last]), || format!("the program printed: {lost}"))?;
    let rests = run.wait_for("check the cameras", None)?;
    follow_again(person)?;
    Ok(format!("{rests}; then {}", place(world)?))
}

/// Waits until the hand follows again, and resumes where that needs a command.
fn follow_again(person: &Client) -> Result<(), Box<dyn Error>> {
    let is_tracking = |state: &Value| state["state"]["name"] == "tracking";
    let may_resume = |state: &Value| state["state"]["may"].as_array().is_some_and(|may| may.contains(&json!("resume")));
    let state = person.wait_for("a hand that may continue", |state| is_tracking(state) || may_resume(state));
    if !is_tracking(&state) {
        command(person, "resume", json!({}))?;
        wait_for_state(person, "tracking");
    }
    Ok(())
}

fn end(world: &World, run: Running, person: Client) -> Outcome {
    command(&person, "hold", json!({}))?;
    let holding = wait_for_state(&person, "holding");
    ensure(person.post("stop", "{}").status == 200, || "stop is refused".to_owned())?;
    wait_for_state(&person, "stopped");
    // No heartbeat goes to a program that ends.
    drop(person);
    run.interrupt()?;
    let status = run.end()?;
    ensure(status.code() == Some(INTERRUPTED.into()), || format!("the run ended with {status}"))?;
    for arm in world.arms() {
        ensure(arm.is_braked, || format!("the brakes of an arm are open: {arm}"))?;
    }
    Ok(holding["why"]["line"].as_str().unwrap_or_default().to_owned())
}
