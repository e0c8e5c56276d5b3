//! The requests about cameras: controls, and checks of the images.

use std::time::Duration;

use axum::Extension;
use axum::extract::{Request, State};
use axum::response::Response;
use serde::Serialize;

use super::answers::json;
use super::app::App;
use super::commands::{Answered, Asked};
use super::{Peer, body};
use crate::camera_control::CameraAnswer;
use crate::hub::Hub;
use crate::messages::cameras::CameraCheck;
use crate::messages::requests::{CameraSide, ControlRequest};
use crate::refusal::Refusal;

/// Time in which a change is answered: the cameras take it or refuse it, then the driver works.
const SET_WITHIN: Duration = Duration::from_millis(2500);
/// Time in which the cameras read their controls; after it the answer has the values that are known.
const READ_WITHIN: Duration = Duration::from_millis(700);
/// Time in which images are checked; after it the answer has the previous check.
const CHECKED_WITHIN: Duration = Duration::from_millis(1500);

/// `GET /api/controls`.
pub async fn controls(State(App { hub, .. }): State<App>) -> Response {
    let mut failure = None;
    if let Some(read) = hub.read_controls() {
        // What was not read in time is shown as it was.
        let result = tokio::time::timeout(READ_WITHIN, read).await;
        failure = result.ok().and_then(Result::ok).and_then(Result::err);
    }
    let mut answer = hub.controls_answer(None);
    answer.problem = answer.problem.or(failure);
    json(&answer)
}

/// `POST /api/controls`: sets one control and reads it back.
pub async fn set_control(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("controls", &request, peer);
    asked.count(&app)?;
    let request: ControlRequest = body::read(request).await?;
    let hub = &app.hub;
    let holder = hub.check_holder(asked.session());
    let given = holder.as_ref().map_err(Clone::clone);
    let given = given.and_then(|_| hub.change_control(request.side.index(), request.id, request.value));
    let outcome = match given {
        Ok(answer) => finished(answer).await.map(|()| line_of(hub, &request)),
        Err(refusal) => Err(refusal),
    };
    if let Ok(line) = &outcome {
        tracing::info!(target: "pb3dp_panel::audit", "controls: {line}");
    }
    let line = asked.audit(holder.ok().as_ref(), outcome)?;
    Ok(json(&hub.controls_answer(Some(line))))
}

async fn finished(answer: CameraAnswer) -> Result<(), Refusal> {
    match tokio::time::timeout(SET_WITHIN, answer).await {
        Ok(Ok(result)) => result.map_err(|why| Refusal::Control { why }),
        Ok(Err(_)) => Err(Refusal::Control { why: "the cameras were closed; check them".to_owned() }),
        Err(_) => {
            let limit_ms = SET_WITHIN.as_millis();
            Err(Refusal::Control {
                why: format!("the camera has not answered within {limit_ms} ms; read the controls again"),
            })
        }
    }
}

/// What was set, as it was read back.
fn line_of(hub: &Hub, request: &ControlRequest) -> String {
    let ControlRequest { side, id, value, .. } = *request;
    let camera = hub.controls_answer(None).cameras.into_iter().nth(side.index());
    let control = camera.and_then(|camera| camera.controls.into_iter().find(|control| control.id == id));
    let side = if side == CameraSide::Left { "left" } else { "right" };
    match control {
        Some(control) => match control.value {
            Some(now) => format!("{side} `{}` is {now}", control.name),
            None => format!("{side} `{}`: done", control.name),
        },
        None => format!("{side} {id:#010x} is {value}"),
    }
}

#[derive(Serialize)]
struct CamerasAnswer<'a> {
    check: Option<&'a CameraCheck>,
}

/// `GET /api/cameras`: the images of a pair against the limits of `pb3dp cameras check`.
pub async fn cameras(State(App { hub, .. }): State<App>) -> Response {
    let mut newest = hub.image_checks.ask();
    // Without images, or on a busy computer, the previous one.
    let _ = tokio::time::timeout(CHECKED_WITHIN, newest.changed()).await;
    let check = newest.borrow().clone();
    json(&CamerasAnswer { check: check.as_deref() })
}
