//! Limits on the number of open connections.
//!
//! A new connection is always accepted; otherwise a client that holds all places would keep the operator from *stop*.
//! At a limit another connection is closed for it: first one that has not authenticated, then one without a request in
//! progress, then the one that has been idle longest.

use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::Notify;

use dbbd_device::sync::lock;

/// Connections at a time.
const MOST: usize = 256;
/// Of them, connections that have not authenticated. The other places are reserved for those that have.
const MOST_UNAUTHENTICATED: usize = 128;
/// Of them, from one address.
const MOST_UNAUTHENTICATED_PER_ADDRESS: usize = 32;

#[derive(Clone, Default)]
pub(super) struct Connections(Arc<Mutex<Table>>);

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
pub(super) struct Place {
    pub(super) peer: Peer,
    /// Notified when the connection is to be closed.
    pub(super) close: Arc<Notify>,
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
        let found = if open().filter(same_address).count() >= MOST_UNAUTHENTICATED_PER_ADDRESS {
            open().filter(same_address).min_by_key(order)
        } else if open().filter(|(_, entry)| !entry.authenticated).count() >= MOST_UNAUTHENTICATED
            || self.open.len() >= MOST
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
    pub(super) fn enter(&self, address: IpAddr) -> (Place, Option<IpAddr>) {
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
