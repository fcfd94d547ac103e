//! Connections: how many, how long their heads may take, and their end.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::connections::{Connections, Place};
use super::guard::Site;
use super::stall::Stalling;

/// How long the head of a request may take.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// Longest head of a request, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
/// What the system may hold for a client that does not read, bytes: what is older is not worth a look.
const SEND_BUFFER: u32 = 64 * 1024;
/// How long open requests may take at the end.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// An address on which the service listens.
///
/// # Errors
/// When it cannot be had.
pub(super) fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(128)
}

/// Serves a site at `address` until `stop` says so; `ready` is given the address once.
///
/// # Errors
/// When the address cannot be had.
pub async fn serve(
    address: SocketAddr,
    site: Site,
    mut stop: watch::Receiver<bool>,
    ready: impl FnOnce(SocketAddr),
) -> io::Result<()> {
    let listener = listen(address)?;
    ready(listener.local_addr()?);
    let open = Connections::default();
    let mut connections = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            _ = stop.wait_for(|stop| *stop) => break,
            accepted = listener.accept() => accepted,
        };
        while connections.try_join_next().is_some() {}
        match accepted {
            Ok((stream, from)) => {
                let (place, gone) = open.enter(from.ip());
                if let Some(gone) = gone {
                    site.journal.warn("connection_shed", &[("address", &gone), ("for", &from.ip())]);
                }
                let router = site.router.clone().layer(Extension(place.peer(from.ip())));
                connections.spawn(talk(stream, router, stop.clone(), place));
            }
            // Out of file handles, as a rule: others must go first.
            Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
        }
    }
    drop(listener);
    let _ = timeout(LAST_WORDS, async { while connections.join_next().await.is_some() {} }).await;
    Ok(())
}

async fn talk(stream: TcpStream, router: Router, mut stop: watch::Receiver<bool>, place: Place) {
    // Frames are small and must not wait for each other.
    let _ = stream.set_nodelay(true);
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME)
        .max_buf_size(LONGEST_HEAD)
        // The library ends the process where the clock has no date of four digits.
        .auto_date_header(false)
        .serve_connection(TokioIo::new(Stalling::new(stream)), TowerToHyperService::new(router));
    let mut connection = std::pin::pin!(connection);
    // How it ends is the client's affair.
    tokio::select! {
        _ = &mut connection => return,
        () = place.end.notified() => return,
        _ = stop.wait_for(|stop| *stop) => connection.as_mut().graceful_shutdown(),
    }
    let _ = connection.await;
}
