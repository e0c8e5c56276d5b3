//! HTTP server of the panel on a thread of its own, with limits on number, size and time of requests.

mod answers;
mod app;
mod assets;
mod body;
mod cameras;
mod checks;
mod commands;
mod rate;
mod routes;
mod socket;
mod tls;

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustix::net::sockopt::set_socket_send_buffer_size;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use tokio_rustls::TlsAcceptor;

pub use self::tls::OwnCertificate;
use self::tls::Tls;
use crate::hub::Hub;
use crate::refusal::Refusal;

/// Connections; a browser with the page has two or three.
pub const CONNECTIONS_MAX: usize = 32;
/// Further connections, on which only `stop` and `hold` are accepted. A new one ends another of them, so that other clients cannot keep
/// these commands from anybody: the oldest one that has sent no request, else the oldest; a command that was read is carried out in any case.
const URGENT_CONNECTIONS_MAX: usize = 8;
/// Largest head of a request, bytes.
const HEAD_MAX: usize = 16 * 1024;
/// Time limit of a head; the second one is that of the further connections.
const HEAD_TIME: Duration = Duration::from_secs(10);
const URGENT_HEAD_TIME: Duration = Duration::from_secs(2);
/// Send buffer of a connection, for four stereo pairs of 640x480: what waits in it can no longer be replaced by something newer. At half
/// of it a large image needs several turns; at double an operator may see images that are half a second old.
const SEND_BUFFER_BYTES: usize = 256 * 1024;
/// Time in which one of the further connections ends for another one.
const GIVES_WAY_WITHIN: Duration = Duration::from_millis(100);
/// Time limit of the first messages of TLS.
const HANDSHAKE_TIME: Duration = Duration::from_secs(5);

/// The other end of a connection.
#[derive(Clone, Debug)]
pub struct Peer {
    /// Its address.
    pub address: SocketAddr,
    /// Whether only `stop` and `hold` are accepted.
    pub is_urgent_only: bool,
    /// Whether the head of a request has come.
    pub has_asked: Arc<AtomicBool>,
    /// Place among the connections; a WebSocket outlives the HTTP connection that it came from.
    _permit: Arc<OwnedSemaphorePermit>,
}

/// A running server; dropping it ends the server with all connections.
pub struct Server {
    address: SocketAddr,
    certificate: Option<OwnCertificate>,
    over: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Binds the address and starts.
    ///
    /// # Errors
    /// If the address can be reached from other computers without protection, or cannot be used, or there is no thread.
    pub fn start(hub: &Arc<Hub>) -> Result<Self, Refusal> {
        let address = hub.config.address;
        let tls = hub.config.protection.as_ref().map(Tls::new).transpose()?;
        if tls.is_none() && !address.ip().is_loopback() {
            return Err(Refusal::Unprotected { address: address.to_string() });
        }
        let (acceptor, certificate) = tls.map(|tls| (tls.acceptor, tls.certificate)).unzip();
        let no_thread = |error: std::io::Error| Refusal::Thread { cause: error.to_string() };
        let not_bound =
            |error: std::io::Error| Refusal::Address { address: address.to_string(), cause: error.to_string() };
        let runtime = Builder::new_current_thread().enable_all().build().map_err(no_thread)?;
        let listener = runtime.block_on(TcpListener::bind(address)).map_err(not_bound)?;
        let address = listener.local_addr().map_err(not_bound)?;
        let (over, is_over) = oneshot::channel();
        let hub = Arc::clone(hub);
        let serve = move || serve(&runtime, (&listener, acceptor), is_over, &hub);
        let thread = std::thread::Builder::new().name("panel".to_owned()).spawn(serve).map_err(no_thread)?;
        Ok(Self { address, certificate, over: Some(over), thread: Some(thread) })
    }

    /// The certificate of a protected panel.
    pub fn certificate(&self) -> Option<&OwnCertificate> {
        self.certificate.as_ref()
    }

    /// The address, with the port that was taken.
    pub fn address(&self) -> SocketAddr {
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
fn serve(
    runtime: &Runtime,
    (listener, acceptor): (&TcpListener, Option<TlsAcceptor>),
    is_over: oneshot::Receiver<()>,
    hub: &Arc<Hub>,
) {
    let normal = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let urgent = Arc::new(Semaphore::new(URGENT_CONNECTIONS_MAX));
    let router = routes::router(hub);
    // Of the further connections, the oldest first.
    let mut open = VecDeque::new();
    runtime.block_on(async {
        let accept = async {
            loop {
                let Ok((socket, address)) = listener.accept().await else {
                    // The system has no room for one more just now.
                    tokio::time::sleep(Duration::from_millis(50)).await;
                    continue;
                };
                let (acceptor, router) = (acceptor.clone(), router.clone());
                let peer = |permit, is_urgent_only| Peer {
                    address,
                    is_urgent_only,
                    has_asked: Arc::default(),
                    _permit: Arc::new(permit),
                };
                if let Ok(permit) = Arc::clone(&normal).try_acquire_owned() {
                    tokio::spawn(connection(socket, acceptor, router, peer(permit, false)));
                } else if let Some(permit) = urgent_place(&urgent, &mut open).await {
                    let (end, is_ended) = oneshot::channel::<()>();
                    let peer = peer(permit, true);
                    open.push_back(Urgent { end, has_asked: Arc::clone(&peer.has_asked) });
                    let serving = connection(socket, acceptor, router, peer);
                    tokio::spawn(async move {
                        tokio::select! {
                            () = serving => {}
                            _ = is_ended => {}
                        }
                    });
                }
                // A request that is there already is read before the next connection can end it.
                tokio::task::yield_now().await;
            }
        };
        tokio::select! {
            _ = is_over => {}
            () = accept => {}
        }
    });
}

/// One of the further connections, which ends when this value is dropped.
struct Urgent {
    end: oneshot::Sender<()>,
    has_asked: Arc<AtomicBool>,
}

/// A place among the further connections; another one ends if there is none. `None` if it does not end in time.
async fn urgent_place(places: &Arc<Semaphore>, open: &mut VecDeque<Urgent>) -> Option<OwnedSemaphorePermit> {
    open.retain(|one| !one.end.is_closed());
    if places.available_permits() == 0 {
        let is_silent = |one: &Urgent| !one.has_asked.load(Ordering::SeqCst);
        drop(open.remove(open.iter().position(is_silent).unwrap_or(0)));
    }
    tokio::time::timeout(GIVES_WAY_WITHIN, Arc::clone(places).acquire_owned()).await.ok()?.ok()
}

async fn connection(socket: TcpStream, acceptor: Option<TlsAcceptor>, router: Router, peer: Peer) {
    // Small messages must not wait for others; without it they are late, not wrong.
    let _ = socket.set_nodelay(true);
    let _ = set_socket_send_buffer_size(&socket, SEND_BUFFER_BYTES);
    match acceptor {
        None => http(socket, router, peer).await,
        // A client without TLS, or one that is too slow, ends its own connection only.
        Some(acceptor) => {
            if let Ok(Ok(socket)) = tokio::time::timeout(HANDSHAKE_TIME, acceptor.accept(socket)).await {
                http(socket, router, peer).await;
            }
        }
    }
}

async fn http(socket: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, router: Router, peer: Peer) {
    let is_urgent_only = peer.is_urgent_only;
    let service = TowerToHyperService::new(router.layer(Extension(peer)));
    let mut builder = http1::Builder::new();
    let head_time = if is_urgent_only { URGENT_HEAD_TIME } else { HEAD_TIME };
    builder.timer(TokioTimer::new()).header_read_timeout(head_time).max_buf_size(HEAD_MAX);
    // Another one waits for its place.
    builder.keep_alive(!is_urgent_only);
    // A client that goes, or sends no HTTP, ends its own connection only.
    let _ = builder.serve_connection(TokioIo::new(socket), service).with_upgrades().await;
}
