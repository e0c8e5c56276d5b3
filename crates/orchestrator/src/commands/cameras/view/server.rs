//! HTTP server of the page, with limits on number, size and time of requests.

use std::future::poll_fn;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::task::Poll;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{CONTENT_TYPE, HOST};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use pb3dp_camera_v4l2::Side;
use serde::Deserialize;
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{Semaphore, mpsc, oneshot, watch};

use super::answers::{Content, Refusal, json, stream, whole};
use super::show::{ControlRequest, Images, PendingRequest, State};
use crate::commands::cameras::list::ControlLine;

/// The page with its scripts and styles.
const PAGE: &str = include_str!("page.html");

/// Maximum number of connections; a browser has six.
const CONNECTIONS_MAX: usize = 32;

/// Maximum size of a request's head and body, bytes.
const HEAD_MAX: usize = 16 * 1024;
const BODY_MAX: usize = 4 * 1024;

/// Time limits for a request's head and body, and for an answer of the cameras.
const CLIENT_PATIENCE: Duration = Duration::from_secs(10);
const CAMERA_PATIENCE: Duration = Duration::from_secs(3);

/// Time between the images of a stream.
const BOUNDARY: &str = "pb3dp-next-image";
const STREAM_KIND: &str = "multipart/x-mixed-replace; boundary=pb3dp-next-image";

/// Source of the page's data.
#[derive(Clone)]
pub(super) struct Sources {
    pub(super) states: watch::Receiver<Arc<State>>,
    pub(super) images: watch::Receiver<Option<Arc<Images>>>,
    pub(super) ask: SyncSender<PendingRequest>,
}

/// A running server; dropping it ends the server.
pub(super) struct Server {
    address: SocketAddr,
    over: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Binds the address and starts.
    ///
    /// # Errors
    /// If the address is in use or not of this computer, or the system provides no thread.
    pub(super) fn start(address: SocketAddr, sources: Sources) -> Result<Self> {
        let runtime = Builder::new_current_thread().enable_all().build().context("no server can be made")?;
        let listener = runtime.block_on(TcpListener::bind(address)).with_context(|| {
            format!("{address} cannot be used for the page; give another --port (0: any that is free) or --bind")
        })?;
        let address = listener.local_addr().context("the page has no address")?;
        let (over, is_over) = oneshot::channel();
        let serve = move || serve(&runtime, &listener, is_over, &sources);
        let thread =
            std::thread::Builder::new().name("page".to_owned()).spawn(serve).context("no thread for the page")?;
        Ok(Self { address, over: Some(over), thread: Some(thread) })
    }

    /// Address of the page.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.over.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the server was reported already.
            let _ = thread.join();
        }
    }
}

/// Serves until the end; all connections end with the runtime.
fn serve(runtime: &Runtime, listener: &TcpListener, mut is_over: oneshot::Receiver<()>, sources: &Sources) {
    let connections = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    runtime.block_on(async {
        loop {
            let accepted = poll_fn(|context| {
                if Future::poll(Pin::new(&mut is_over), context).is_ready() {
                    return Poll::Ready(None);
                }
                listener.poll_accept(context).map(Some)
            });
            match accepted.await {
                None => return,
                Some(Ok((socket, _))) => {
                    // One more than are allowed is closed at once.
                    let Ok(permit) = Arc::clone(&connections).try_acquire_owned() else { continue };
                    let sources = sources.clone();
                    runtime.spawn(async move {
                        connection(socket, sources).await;
                        drop(permit);
                    });
                }
                // The system has no room for one more just now.
                Some(Err(_)) => tokio::time::sleep(Duration::from_millis(50)).await,
            }
        }
    });
}

async fn connection(socket: TcpStream, sources: Sources) {
    let service = service_fn(move |request| {
        let sources = sources.clone();
        async move {
            let response = answer(request, &sources).await.unwrap_or_else(|refusal| refusal.response());
            Ok::<_, std::convert::Infallible>(response)
        }
    });
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(CLIENT_PATIENCE).max_buf_size(HEAD_MAX);
    // A client that goes, or sends what is no HTTP, ends its own connection only.
    let _ = builder.serve_connection(TokioIo::new(socket), service).await;
}

async fn answer(request: Request<Incoming>, sources: &Sources) -> Result<Response<Content>, Refusal> {
    check_host(&request)?;
    let path = request.uri().path().to_owned();
    let is_get = matches!(*request.method(), Method::GET | Method::HEAD);
    let side = side_in(&path);
    match (path.as_str(), side) {
        ("/controls/left" | "/controls/right", Some(side)) => {
            let request = match *request.method() {
                Method::GET => ControlRequest::Controls,
                Method::POST => wish_in(request).await?,
                _ => return Err(not_allowed(&request, "GET or POST")),
            };
            ask(sources, side, request).await.map(|controls| json(&controls))
        }
        _ if !is_get => Err(match path.as_str() {
            "/" | "/state" | "/left.jpg" | "/right.jpg" | "/left.mjpg" | "/right.mjpg" => not_allowed(&request, "GET"),
            _ => unknown(&path),
        }),
        ("/", _) => Ok(whole("text/html; charset=utf-8", PAGE)),
        ("/state", _) => {
            let state = Arc::clone(&sources.states.borrow());
            Ok(json(state.as_ref()))
        }
        ("/left.jpg" | "/right.jpg", Some(side)) => {
            let images = sources.images.borrow().clone();
            let images = images.ok_or_else(|| {
                Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "no pair has come yet; /state says why")
            })?;
            Ok(whole("image/jpeg", images.jpegs[side as usize].clone()))
        }
        ("/left.mjpg" | "/right.mjpg", Some(side)) => Ok(stream(STREAM_KIND, images_of(side, sources.images.clone()))),
        _ => Err(unknown(&path)),
    }
}

fn side_in(path: &str) -> Option<Side> {
    if path.contains("left") {
        Some(Side::Left)
    } else if path.contains("right") {
        Some(Side::Right)
    } else {
        None
    }
}

fn unknown(path: &str) -> Refusal {
    let shown: String = path.chars().take(80).collect();
    Refusal::new(
        StatusCode::NOT_FOUND,
        format!(
            "{shown} is not here; there are /, /state, /left.jpg, /right.jpg, /left.mjpg, /right.mjpg, /controls/left, /controls/right"
        ),
    )
}

fn not_allowed(request: &Request<Incoming>, allowed: &str) -> Refusal {
    let error = format!("{} is not for {}; use {allowed}", request.method(), request.uri().path());
    Refusal::new(StatusCode::METHOD_NOT_ALLOWED, error)
}

/// A page from elsewhere may give its own name the address of this computer (DNS rebinding); an address it cannot invent.
fn check_host(request: &Request<Incoming>) -> Result<(), Refusal> {
    let host = request.headers().get(HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let is_address = host.parse::<SocketAddr>().is_ok()
        || host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().is_ok();
    let is_local =
        host == "localhost" || host.strip_prefix("localhost:").is_some_and(|port| port.parse::<u16>().is_ok());
    if is_address || is_local {
        return Ok(());
    }
    let error = "the header `Host` names neither localhost nor an address; open the page by the address that the program has printed";
    Err(Refusal::new(StatusCode::FORBIDDEN, error))
}

/// What a POST asks for.
async fn wish_in(request: Request<Incoming>) -> Result<ControlRequest, Refusal> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Change {
        id: u32,
        value: i32,
    }
    const EXAMPLE: &str = "{\"id\": 9963795, \"value\": 32}";
    // Pages from elsewhere cannot send this type unasked.
    let is_json =
        |kind: &str| kind.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"));
    let kind = request.headers().get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    if !is_json(kind) {
        let shown: String = kind.chars().take(80).collect();
        let error = format!("the content type is {shown:?}; send application/json, for instance {EXAMPLE}");
        return Err(Refusal::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, error));
    }
    let body = tokio::time::timeout(CLIENT_PATIENCE, Limited::new(request.into_body(), BODY_MAX).collect()).await;
    let body = body.map_err(|_| {
        Refusal::new(StatusCode::REQUEST_TIMEOUT, format!("the body did not come within {CLIENT_PATIENCE:?}"))
    })?;
    let bytes = body.map_err(|error| {
        if error.is::<LengthLimitError>() {
            let error = format!("the body has more than {BODY_MAX} bytes; send for instance {EXAMPLE}");
            Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, error)
        } else {
            Refusal::new(StatusCode::BAD_REQUEST, format!("the body cannot be read: {error}"))
        }
    })?;
    let change: Change = serde_json::from_slice(&bytes.to_bytes()).map_err(|error| {
        Refusal::new(
            StatusCode::BAD_REQUEST,
            format!("the body is not understood: {error}; send for instance {EXAMPLE}"),
        )
    })?;
    Ok(ControlRequest::Set { id: change.id, value: change.value })
}

async fn ask(sources: &Sources, side: Side, request: ControlRequest) -> Result<Vec<ControlLine>, Refusal> {
    let is_change = matches!(request, ControlRequest::Set { .. });
    let (answer, answered) = oneshot::channel();
    let busy = || {
        Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "the cameras do not answer now; try again, and look at /state")
    };
    sources.ask.try_send(PendingRequest { side, request, answer }).map_err(|_| busy())?;
    let answered = tokio::time::timeout(CAMERA_PATIENCE, answered).await;
    let status = if is_change { StatusCode::CONFLICT } else { StatusCode::SERVICE_UNAVAILABLE };
    match answered {
        Ok(Ok(answer)) => answer.map_err(|error| Refusal::new(status, error)),
        _ => Err(busy()),
    }
}

/// The images of one side, each as a part of the stream; one that a slow reader misses is left out.
fn images_of(side: Side, mut newest: watch::Receiver<Option<Arc<Images>>>) -> mpsc::Receiver<Bytes> {
    let (give, take) = mpsc::channel(1);
    // The one that is there now is shown at once.
    newest.mark_changed();
    tokio::spawn(async move {
        // A browser shows a part once it has seen the boundary behind it.
        let mut part = format!("--{BOUNDARY}").into_bytes();
        while newest.changed().await.is_ok() {
            let images = newest.borrow_and_update().clone();
            let Some(images) = images else { continue };
            let jpeg = &images.jpegs[side as usize];
            let head = format!("\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
            part.extend_from_slice(head.as_bytes());
            part.extend_from_slice(jpeg);
            part.extend_from_slice(format!("\r\n--{BOUNDARY}").as_bytes());
            if give.send(std::mem::take(&mut part).into()).await.is_err() {
                return;
            }
        }
    });
    take
}
