//! The HTTP server: accepts connections and limits their number, the size and time of request heads, and send stalls.

use std::future::Future;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Sleep, sleep, timeout};

use super::connections::{Connections, Place};
use super::guard::Site;

/// Timeout for the head of a request.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// Longest head of a request, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
/// Send buffer of the system per connection, bytes. A client that does not read has no use for more.
const SEND_BUFFER: u32 = 64 * 1024;
/// Timeout for a client that does not read what is sent.
const SEND_TIME: Duration = Duration::from_secs(30);
/// Timeout for open requests when the service stops.
const SHUTDOWN_TIME: Duration = Duration::from_secs(2);

fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(128)
}

/// Serves a site at `address` until `stop` is true. `ready` receives the bound address.
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
                let (place, closed) = open.enter(from.ip());
                if let Some(closed) = closed {
                    site.journal.warn("connection_shed", &[("address", &closed), ("for", &from.ip())]);
                }
                let router = site.router.clone().layer(Extension(place.peer.clone()));
                connections.spawn(serve_connection(stream, router, stop.clone(), place));
            }
            // Usually out of file handles: wait until other connections close.
            Err(_) => sleep(Duration::from_millis(50)).await,
        }
    }
    drop(listener);
    let _ = timeout(SHUTDOWN_TIME, async { while connections.join_next().await.is_some() {} }).await;
    Ok(())
}

async fn serve_connection(stream: TcpStream, router: Router, mut stop: watch::Receiver<bool>, place: Place) {
    // Live frames are small and must not be delayed by Nagle's algorithm.
    let _ = stream.set_nodelay(true);
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME)
        .max_buf_size(LONGEST_HEAD)
        // hyper panics when the year of the system clock does not have four digits.
        .auto_date_header(false)
        .serve_connection(
            TokioIo::new(SendTimeout { stream, since: None }),
            TowerToHyperService::new(router),
        );
    let mut connection = std::pin::pin!(connection);
    // Errors of a connection concern its client only.
    tokio::select! {
        _ = &mut connection => return,
        () = place.close.notified() => return,
        _ = stop.wait_for(|stop| *stop) => connection.as_mut().graceful_shutdown(),
    }
    let _ = connection.await;
}

/// A connection that fails when the client reads nothing for [`SEND_TIME`]. hyper has no such timeout.
struct SendTimeout {
    stream: TcpStream,
    since: Option<Pin<Box<Sleep>>>,
}

impl SendTimeout {
    fn limit<T>(&mut self, poll: Poll<io::Result<T>>, context: &mut Context<'_>) -> Poll<io::Result<T>> {
        if poll.is_ready() {
            self.since = None;
            return poll;
        }
        let since = self.since.get_or_insert_with(|| Box::pin(sleep(SEND_TIME)));
        since.as_mut().poll(context).map(|()| Err(ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for SendTimeout {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for SendTimeout {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.limit(poll, context)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let poll = Pin::new(&mut self.stream).poll_flush(context);
        self.limit(poll, context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let poll = Pin::new(&mut self.stream).poll_shutdown(context);
        self.limit(poll, context)
    }
}
