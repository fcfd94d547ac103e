//! The HTTP server: accepts connections and limits their number, the size and time of request heads, and send stalls.
//!
//! A new connection is always accepted; otherwise a client that holds all places would keep the operator from *stop*.
//! At a limit another connection is closed for it: first one that has not authenticated, then one without a request in
//! progress, then the one that has been idle longest.

use std::future::Future;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use tokio::time::{Sleep, sleep, timeout};

use super::Site;
use dbbd_device::sync::lock;

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

/// Connections at a time.
const MAX_CONNECTIONS: usize = 256;
/// Of them, connections that have not authenticated. The other places are reserved for those that have.
const MAX_UNAUTHENTICATED: usize = 128;
/// Of them, from one address.
const MAX_UNAUTHENTICATED_PER_ADDRESS: usize = 32;

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

#[derive(Clone, Default)]
struct Connections(Arc<Mutex<Table>>);

#[derive(Default)]
struct Table {
    open: Vec<Entry>,
    events: u64,
}

struct Entry {
    id: u64,
    address: IpAddr,
    authenticated: bool,
    /// Requests in progress.
    busy: usize,
    /// Number of the last event: lower means idle for longer.
    last_event: u64,
    close: Arc<Notify>,
}

/// An open connection. Dropping it frees its place.
struct Place {
    peer: Peer,
    /// Notified when the connection is to be closed.
    close: Arc<Notify>,
}

/// A connection as its requests see it.
#[derive(Clone)]
pub(super) struct Peer {
    connections: Connections,
    id: u64,
    pub(super) address: IpAddr,
}

/// A request in progress, until it is dropped.
pub(super) struct Busy(Peer);

impl Table {
    fn next_event(&mut self) -> u64 {
        self.events += 1;
        self.events
    }

    /// Index of the connection to close for a new one from `address`; `None` below the limits.
    fn to_close(&self, address: IpAddr) -> Option<usize> {
        let open = || self.open.iter().enumerate();
        let same_address = |(_, entry): &(usize, &Entry)| !entry.authenticated && entry.address == address;
        let order = |(_, entry): &(usize, &Entry)| (entry.authenticated, entry.busy > 0, entry.last_event);
        let found = if open().filter(same_address).count() >= MAX_UNAUTHENTICATED_PER_ADDRESS {
            open().filter(same_address).min_by_key(order)
        } else if open().filter(|(_, entry)| !entry.authenticated).count() >= MAX_UNAUTHENTICATED
            || self.open.len() >= MAX_CONNECTIONS
        {
            open().min_by_key(order)
        } else {
            None
        };
        found.map(|(at, _)| at)
    }
}

impl Connections {
    fn table(&self) -> MutexGuard<'_, Table> {
        lock(&self.0)
    }

    /// Adds a connection. Also returns the address of the connection that is closed for it.
    fn enter(&self, address: IpAddr) -> (Place, Option<IpAddr>) {
        let mut table = self.table();
        let closed = table.to_close(address).map(|at| table.open.swap_remove(at));
        if let Some(entry) = &closed {
            entry.close.notify_one();
        }
        let id = table.next_event();
        let close = Arc::new(Notify::new());
        table.open.push(Entry {
            id,
            address,
            authenticated: false,
            busy: 0,
            last_event: id,
            close: Arc::clone(&close),
        });
        let peer = Peer { connections: self.clone(), id, address };
        (Place { peer, close }, closed.map(|entry| entry.address))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.peer.connections.table().open.retain(|entry| entry.id != self.peer.id);
    }
}

impl Peer {
    fn change(&self, change: impl FnOnce(&mut Entry)) {
        let mut table = self.connections.table();
        let event = table.next_event();
        if let Some(entry) = table.open.iter_mut().find(|entry| entry.id == self.id) {
            entry.last_event = event;
            change(entry);
        }
    }

    /// Notes whether the last request was authenticated.
    pub(super) fn authenticated(&self, authenticated: bool) {
        self.change(|entry| entry.authenticated = authenticated);
    }

    /// Notes that a request begins.
    pub(super) fn busy(&self) -> Busy {
        self.change(|entry| entry.busy += 1);
        Busy(self.clone())
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.change(|entry| entry.busy = entry.busy.saturating_sub(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(number: u8) -> IpAddr {
        [10, 0, 0, number].into()
    }

    fn open(connections: &Connections, address: IpAddr, count: usize, authenticated: bool) -> Vec<Place> {
        let enter = |_| {
            let (place, closed) = connections.enter(address);
            assert_eq!(closed, None);
            place.peer.authenticated(authenticated);
            place
        };
        (0..count).map(enter).collect()
    }

    #[test]
    fn thirty_third_unauthenticated_connection_of_an_address_closes_its_oldest() {
        let connections = Connections::default();
        let places = open(&connections, ip(1), 32, false);
        let other = open(&connections, ip(2), 1, false);
        // The first has the latest event, so that the second has been idle longest.
        places[0].peer.authenticated(false);
        let (_new, closed) = connections.enter(ip(1));
        assert_eq!(closed, Some(ip(1)));
        let is_open = |place: &Place| connections.table().open.iter().any(|entry| entry.id == place.peer.id);
        assert!(is_open(&places[0]) && !is_open(&places[1]) && is_open(&places[2]) && is_open(&other[0]));
    }

    #[test]
    fn authenticated_connections_have_half_of_the_places_to_themselves() {
        let connections = Connections::default();
        let mine = open(&connections, ip(1), 100, true);
        let strangers: Vec<Place> =
            (2..6).flat_map(|number| open(&connections, ip(number), 32, false)).collect();
        assert_eq!(strangers.len(), 128);
        let (_new, closed) = connections.enter(ip(9));
        assert_eq!(closed, Some(ip(2)));
        assert!(mine.iter().all(|place| connections.table().open.iter().any(|e| e.id == place.peer.id)));
    }

    #[test]
    fn at_256_connections_one_without_a_request_goes_first() {
        let connections = Connections::default();
        let places = open(&connections, ip(1), 256, true);
        let _busy: Vec<Busy> = places[..255].iter().map(|place| place.peer.busy()).collect();
        let (new, closed) = connections.enter(ip(2));
        assert_eq!(closed, Some(ip(1)));
        let is_open = |place: &Place| connections.table().open.iter().any(|entry| entry.id == place.peer.id);
        assert!(is_open(&places[0]) && !is_open(&places[255]) && is_open(&new));
        // A place that is dropped is free.
        drop(places);
        assert_eq!(connections.table().open.len(), 1);
    }
}
