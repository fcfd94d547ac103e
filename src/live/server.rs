//! The HTTP server: accepts connections and limits their number, the size and time of request heads, and send stalls.
//!
//! Every connection is accepted at once; otherwise those that wait for it would keep the operator from *stop*. At a limit
//! another connection is closed for a new one: first one that has not authenticated, then one of the network that has most,
//! then one without a request in progress, then the one that has been idle longest. A young connection is never closed for
//! another, because its request may be on the way. If only young ones are left, the new connection is closed before
//! anything is allocated for it.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::future::Future;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::Service;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::task::{JoinSet, yield_now};
use tokio::time::{Sleep, sleep, timeout};

use super::Site;
use super::failed_logins::network;
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_model::base::units::HostNs;

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

/// Connections at a time: a quarter of the 1024 descriptors that a process usually has.
const MAX_CONNECTIONS: usize = 256;
/// Connections at a time that have not authenticated. The other places are reserved for authenticated connections.
const MAX_UNAUTHENTICATED: usize = 128;
/// A connection is young for this time after its last event, s. A client sends its request right behind the last packet of
/// the handshake, so that it comes within milliseconds, whatever the delay of the network. With a longer time the places of
/// a network would admit fewer new connections per second than a storm from it makes (64 / 0.01 s = 6400).
const YOUNG_S: f64 = 0.01;
/// Connections that may wait to be accepted. The system lets a client repeat its handshake a second later if there are more.
const BACKLOG: u32 = 4096;

fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?;
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
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
    let router = TowerToHyperService::new(site.router);
    let mut connections = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            _ = stop.wait_for(|stop| *stop) => break,
            accepted = listener.accept() => accepted,
        };
        while connections.try_join_next().is_some() {}
        match accepted {
            Ok((stream, from)) => {
                let address = from.ip();
                match open.enter(address) {
                    Admission::Entered(place, closed) => {
                        if let Some(closed) = closed {
                            site.journal.warn("connection_shed", &[("address", &closed), ("for", &address)]);
                        }
                        connections.spawn(serve_connection(stream, router.clone(), stop.clone(), place));
                        // The connection reads what has arrived before the next one may take its place.
                        yield_now().await;
                    }
                    Admission::Refused => site.journal.warn("connection_refused", &[("address", &address)]),
                }
            }
            // Usually out of file handles: wait until other connections close.
            Err(_) => sleep(Duration::from_millis(50)).await,
        }
    }
    drop(listener);
    let _ = timeout(SHUTDOWN_TIME, async { while connections.join_next().await.is_some() {} }).await;
    Ok(())
}

/// The router of a site, which also shows each request its connection.
struct PeerRouter {
    router: TowerToHyperService<Router>,
    peer: Peer,
}

impl Service<Request<Incoming>> for PeerRouter {
    type Response = <TowerToHyperService<Router> as Service<Request<Incoming>>>::Response;
    type Error = <TowerToHyperService<Router> as Service<Request<Incoming>>>::Error;
    type Future = <TowerToHyperService<Router> as Service<Request<Incoming>>>::Future;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        request.extensions_mut().insert(self.peer.clone());
        self.router.call(request)
    }
}

async fn serve_connection(
    stream: TcpStream,
    router: TowerToHyperService<Router>,
    mut stop: watch::Receiver<bool>,
    place: Place,
) {
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
            PeerRouter { router, peer: place.peer.clone() },
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
    entered: u64,
}

struct Entry {
    id: u64,
    /// The network of the client.
    network: IpAddr,
    authenticated: bool,
    /// Requests in progress.
    busy: usize,
    last_event: HostNs,
    close: Arc<Notify>,
}

/// An open connection. Dropping it frees its place.
struct Place {
    peer: Peer,
    /// Notified when the connection is to be closed.
    close: Arc<Notify>,
}

/// The decision about a new connection.
enum Admission {
    /// The connection has a place. The address is the network of the client whose connection was closed for it.
    Entered(Place, Option<IpAddr>),
    /// There is no place for the connection.
    Refused,
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

/// The connections that compete for a place.
enum Rivals {
    /// There is a free place.
    None,
    /// The connections without authentication in this network.
    Unauthenticated(IpAddr),
    All,
}

impl Table {
    /// Each network has an equal share of the places without authentication, and one share is left for a network that
    /// may come. A network that has used up its share competes with itself. When the places of all networks are used
    /// up, the network that has most of them gives one.
    fn rivals(&self, from: IpAddr) -> Rivals {
        let mut unauthenticated: BTreeMap<IpAddr, usize> = BTreeMap::from([(from, 0)]);
        for entry in self.open.iter().filter(|entry| !entry.authenticated) {
            *unauthenticated.entry(entry.network).or_default() += 1;
        }
        let share = MAX_UNAUTHENTICATED / (unauthenticated.len() + 1);
        if unauthenticated.get(&from).is_some_and(|count| *count >= share.max(1)) {
            return Rivals::Unauthenticated(from);
        }
        let most = unauthenticated.iter().max_by_key(|(_, count)| **count);
        match most {
            Some((most, _)) if unauthenticated.values().sum::<usize>() >= MAX_UNAUTHENTICATED => {
                Rivals::Unauthenticated(*most)
            }
            _ if self.open.len() >= MAX_CONNECTIONS => Rivals::All,
            _ => Rivals::None,
        }
    }

    /// Index of the connection to close for another one, if one of the rivals is not young.
    fn to_close(&self, rivals: &Rivals, now: HostNs) -> Option<usize> {
        let is_rival = |entry: &Entry| match rivals {
            Rivals::None => false,
            Rivals::Unauthenticated(network) => !entry.authenticated && entry.network == *network,
            Rivals::All => true,
        };
        let of_network = |network: IpAddr| match rivals {
            Rivals::All => self.open.iter().filter(|entry| entry.network == network).count(),
            Rivals::None | Rivals::Unauthenticated(_) => 0,
        };
        let open = self.open.iter().enumerate();
        let grown =
            open.filter(|(_, entry)| is_rival(entry) && now.seconds_since(entry.last_event) >= YOUNG_S);
        let order = |(_, entry): &(usize, &Entry)| {
            let most = Reverse(of_network(entry.network));
            (entry.authenticated, most, entry.busy > 0, entry.last_event, entry.id)
        };
        grown.min_by_key(order).map(|(at, _)| at)
    }
}

impl Connections {
    fn table(&self) -> MutexGuard<'_, Table> {
        lock(&self.0)
    }

    /// Adds a connection if there is a place for it.
    fn enter(&self, address: IpAddr) -> Admission {
        self.enter_at(address, clock::now())
    }

    fn enter_at(&self, address: IpAddr, now: HostNs) -> Admission {
        let network = network(address);
        let mut table = self.table();
        let closed = match table.rivals(network) {
            Rivals::None => None,
            rivals @ (Rivals::Unauthenticated(_) | Rivals::All) => match table.to_close(&rivals, now) {
                Some(at) => Some(table.open.swap_remove(at)),
                None => return Admission::Refused,
            },
        };
        if let Some(entry) = &closed {
            entry.close.notify_one();
        }
        table.entered += 1;
        let id = table.entered;
        let close = Arc::new(Notify::new());
        table.open.push(Entry {
            id,
            network,
            authenticated: false,
            busy: 0,
            last_event: now,
            close: Arc::clone(&close),
        });
        let peer = Peer { connections: self.clone(), id, address };
        Admission::Entered(Place { peer, close }, closed.map(|entry| entry.network))
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
        if let Some(entry) = table.open.iter_mut().find(|entry| entry.id == self.id) {
            entry.last_event = clock::now();
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

    const BEGIN: HostNs = HostNs(1_000_000_000);

    fn later(s: f64) -> HostNs {
        HostNs(BEGIN.0 + (s * 1e9) as u64)
    }

    impl Connections {
        /// Opens connections at [`BEGIN`], and sets what the server notes of them.
        fn open(&self, address: IpAddr, count: usize, authenticated: bool, busy: usize) -> Vec<Place> {
            let enter = |_| {
                let Admission::Entered(place, None) = self.enter_at(address, BEGIN) else {
                    panic!("no place")
                };
                let mut table = self.table();
                let entry =
                    table.open.iter_mut().find(|entry| entry.id == place.peer.id).expect("it is open");
                (entry.authenticated, entry.busy) = (authenticated, busy);
                drop(table);
                place
            };
            (0..count).map(enter).collect()
        }

        fn has(&self, place: &Place) -> bool {
            self.table().open.iter().any(|entry| entry.id == place.peer.id)
        }

        /// The network that gave its place, and the new place.
        fn instead(&self, address: IpAddr, now: HostNs) -> Option<(IpAddr, Place)> {
            match self.enter_at(address, now) {
                Admission::Entered(place, closed) => closed.map(|network| (network, place)),
                Admission::Refused => None,
            }
        }
    }

    /// 128 places are 64 for the only network and 64 for one that may come.
    #[test]
    fn network_that_has_used_up_its_places_gives_its_oldest_but_no_young_one() {
        let connections = Connections::default();
        let places = connections.open(ip(1), 64, false, 0);
        assert!(matches!(connections.enter_at(ip(1), later(0.009)), Admission::Refused));
        assert_eq!(connections.table().open.len(), 64);
        // The first has the latest event, so that the second has been idle longest.
        connections.table().open[0].last_event = later(0.005);
        let (closed, _new) = connections.instead(ip(1), later(0.011)).expect("one is not young");
        assert_eq!(closed, ip(1));
        assert!(connections.has(&places[0]) && !connections.has(&places[1]) && connections.has(&places[2]));
    }

    /// A user of IPv6 has 2^64 addresses.
    #[test]
    fn addresses_of_one_network_share_their_places() {
        let connections = Connections::default();
        let address = |number: u16| IpAddr::from([0x2001, 0xdb8, 0, 0, 0, 0, 0, number]);
        let _places: Vec<_> = (0..64).map(|number| connections.open(address(number), 1, false, 0)).collect();
        assert!(matches!(connections.enter_at(address(64), BEGIN), Admission::Refused));
        assert!(matches!(connections.enter_at(ip(1), BEGIN), Admission::Entered(_, None)));
    }

    /// Eight networks have 128 / 9 = 14 places each, which leaves 16 to others, even if all connections are young.
    #[test]
    fn many_networks_leave_places_to_another_one() {
        let connections = Connections::default();
        let storm = (0..1000).map(|number| connections.enter_at(ip(number as u8 % 8), BEGIN));
        let _open: Vec<_> = storm.filter(|one| matches!(one, Admission::Entered(..))).collect();
        let count = |number| connections.table().open.iter().filter(|one| one.network == ip(number)).count();
        assert!((0..8).all(|number| count(number) >= 14), "{:?}", (0..8).map(count).collect::<Vec<_>>());
        assert!(connections.table().open.len() < MAX_UNAUTHENTICATED);
        assert!(matches!(connections.enter_at(ip(9), BEGIN), Admission::Entered(_, None)));
    }

    #[test]
    fn authenticated_connections_have_half_of_the_places_to_themselves() {
        let connections = Connections::default();
        let mine = connections.open(ip(1), 127, true, 0);
        let many = connections.open(ip(2), 64, false, 0);
        let _few: Vec<_> = (3..67).map(|number| connections.open(ip(number), 1, false, 0)).collect();
        // 64 and 64 others: the network with most of them gives its place, even if it is not the oldest.
        connections.table().open.iter_mut().filter(|entry| entry.network == ip(2)).for_each(|entry| {
            entry.last_event = later(0.5);
        });
        let (closed, _new) = connections.instead(ip(99), later(1.0)).expect("one is not young");
        assert_eq!(closed, ip(2));
        assert!(!connections.has(&many[0]) && mine.iter().all(|place| connections.has(place)));
    }

    /// Where no token is required, all who ask are authenticated.
    #[test]
    fn network_with_most_connections_gives_a_place_when_all_are_taken() {
        let connections = Connections::default();
        let _many = connections.open(ip(1), 250, true, 1);
        let idle = connections.open(ip(2), 6, true, 0);
        let (closed, _new) = connections.instead(ip(3), later(1.0)).expect("one is not young");
        assert_eq!(closed, ip(1));
        assert!(idle.iter().all(|place| connections.has(place)));
    }

    #[test]
    fn at_256_connections_one_without_a_request_goes_first() {
        let connections = Connections::default();
        let busy = connections.open(ip(1), 255, true, 1);
        let idle = connections.open(ip(1), 1, true, 0);
        let (closed, new) = connections.instead(ip(2), later(1.0)).expect("one is not young");
        assert_eq!(closed, ip(1));
        assert!(connections.has(&busy[0]) && !connections.has(&idle[0]) && connections.has(&new));
        // A place that is dropped is free.
        drop((busy, idle));
        assert_eq!(connections.table().open.len(), 1);
    }
}
