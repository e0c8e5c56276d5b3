//! All paths of the panel.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::Uri;
use axum::middleware::from_fn_with_state;
use axum::response::Response;
use axum::routing::{any, get, post};
use nalgebra::Vector2;
use serde::Serialize;

use super::answers::{json, json_text};
use super::app::App;
use super::assets::{asset, shortened};
use super::{cameras, checks, commands, socket};
use crate::drawing::epipolar;
use crate::hub::Hub;
use crate::messages::Pixel;
use crate::messages::info::Info;
use crate::refusal::Refusal;

/// Time in which the next state comes: four times its period.
const NEXT_STATE_WITHIN: Duration = Duration::from_millis(200);

/// All paths.
pub fn router(hub: &Arc<Hub>) -> Router {
    let app = App { hub: Arc::clone(hub), rates: Arc::default(), refusals: Arc::default() };
    Router::new()
        .route("/api/info", get(info))
        .route("/api/state", get(state))
        .route("/api/epipolar", get(line))
        .route("/api/cameras", get(cameras::cameras))
        .route("/api/events", get(socket::upgrade))
        .route("/api/lease", post(commands::lease))
        .route("/api/heartbeat", post(commands::heartbeat))
        .route("/api/select", post(commands::select))
        .route("/api/start", post(commands::start))
        .route("/api/resume", post(commands::resume))
        .route("/api/re-align", post(commands::realign))
        .route("/api/reset", post(commands::reset))
        .route("/api/hold", post(commands::hold))
        .route("/api/stop", post(commands::stop))
        .route("/api/speed", post(commands::speed))
        .route("/api/jog", post(commands::jog))
        .route("/api/preview", post(commands::preview))
        .route("/api/push", post(commands::push))
        .route("/api/controls", get(cameras::controls).post(cameras::set_control))
        .route("/api/{*rest}", any(unknown))
        .method_not_allowed_fallback(wrong_method)
        .fallback(page)
        .layer(from_fn_with_state(app.clone(), checks::guard))
        .with_state(app)
}

async fn page(request: Request) -> Result<Response, Refusal> {
    asset(request.method(), request.uri().path())
}

async fn unknown(uri: Uri) -> Refusal {
    Refusal::NotFound { path: shortened(uri.path()) }
}

async fn wrong_method(request: Request) -> Refusal {
    let path = request.uri().path();
    let allowed = match path {
        "/api/info" | "/api/state" | "/api/epipolar" | "/api/cameras" | "/api/events" => "GET",
        "/api/controls" => "GET, POST",
        _ => "POST",
    };
    Refusal::Method { path: shortened(path), method: shortened(request.method().as_str()), allowed }
}

async fn info(State(App { hub, .. }): State<App>) -> Response {
    json(&Info::new(&hub.about, hub.facts()))
}

/// The next state: a script that has just given a command never gets one from before.
async fn state(State(App { hub, .. }): State<App>) -> Response {
    let mut states = hub.states.subscribe();
    states.mark_unchanged();
    // If none comes, the panel ends.
    let _ = tokio::time::timeout(NEXT_STATE_WITHIN, states.changed()).await;
    json_text(states.borrow().to_string())
}

#[derive(Serialize)]
struct Line {
    right_px: Vec<Pixel>,
}

async fn line(State(App { hub, .. }): State<App>, uri: Uri) -> Result<Response, Refusal> {
    let number = |key: &str| {
        let pairs = uri.query().unwrap_or_default().split('&').filter_map(|pair| pair.split_once('='));
        let mut values = pairs.filter(|(name, _)| *name == key).map(|(_, value)| value.parse::<f64>());
        values.next().and_then(Result::ok).filter(|value| value.is_finite())
    };
    let (Some(u), Some(v)) = (number("u"), number("v")) else {
        return Err(Refusal::Body { cause: "the query needs two numbers: ?u=320&v=240".to_owned() });
    };
    hub.about.check_calibrated("epipolar")?;
    Ok(json(&Line { right_px: epipolar(&hub.about.stereo, Vector2::new(u, v)) }))
}
