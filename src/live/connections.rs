//! The open connections: how many there may be, and which one goes when there are too many.
//!
//! A newcomer is always let in, or else whoever holds all places keeps the operator from *stop*. In its place goes
//! another connection: first of those that have not shown the token, then of those without a request at work, the
//! oldest.

use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::Notify;

use crate::base::sync::lock;

/// Connections at a time.
const MOST: usize = 256;
/// Of them, those that have not shown the token: the other places are for those that have.
const MOST_STRANGERS: usize = 128;
/// Of them, those from one address.
const MOST_STRANGERS_PER_ADDRESS: usize = 32;

/// The open connections.
#[derive(Clone, Default)]
pub(super) struct Connections(Arc<Mutex<Table>>);

#[derive(Default)]
struct Table {
    open: Vec<Entry>,
    last: u64,
}

struct Entry {
    id: u64,
    address: IpAddr,
    known: bool,
    /// Requests that are being answered.
    busy: usize,
    /// Number of the last event: the lower, the longer ago.
    moved: u64,
    end: Arc<Notify>,
}

/// A place among them, which is free again when this is dropped.
pub(super) struct Place {
    connections: Connections,
    id: u64,
    pub(super) end: Arc<Notify>,
}

/// One connection, as its requests see it.
#[derive(Clone)]
pub(super) struct Peer {
    connections: Connections,
    id: u64,
    pub(super) address: IpAddr,
}

/// A request at work, for as long as this lives.
pub(super) struct Busy(Peer);

impl Table {
    fn next(&mut self) -> u64 {
        self.last += 1;
        self.last
    }

    /// Which of those that are `meant` goes first.
    fn first_to_go(&self, meant: impl Fn(&Entry) -> bool) -> Option<u64> {
        let meant = self.open.iter().filter(|entry| meant(entry));
        meant.min_by_key(|entry| (entry.known, entry.busy > 0, entry.moved)).map(|entry| entry.id)
    }

    /// The connection in whose place one more from `address` comes, where there are too many.
    fn in_place_of(&self, address: IpAddr) -> Option<u64> {
        let strangers = || self.open.iter().filter(|entry| !entry.known);
        if strangers().filter(|entry| entry.address == address).count() >= MOST_STRANGERS_PER_ADDRESS {
            return self.first_to_go(|entry| !entry.known && entry.address == address);
        }
        if strangers().count() >= MOST_STRANGERS || self.open.len() >= MOST {
            return self.first_to_go(|_| true);
        }
        None
    }
}

impl Connections {
    fn table(&self) -> MutexGuard<'_, Table> {
        lock(&self.0)
    }

    /// A place for a connection from `address`, and the address of the one that had to go for it.
    pub(super) fn enter(&self, address: IpAddr) -> (Place, Option<IpAddr>) {
        let mut table = self.table();
        let gone =
            table.in_place_of(address).and_then(|id| table.open.iter().position(|entry| entry.id == id));
        let gone = gone.map(|at| table.open.swap_remove(at));
        if let Some(entry) = &gone {
            entry.end.notify_one();
        }
        let id = table.next();
        let end = Arc::new(Notify::new());
        table.open.push(Entry { id, address, known: false, busy: 0, moved: id, end: Arc::clone(&end) });
        (Place { connections: self.clone(), id, end }, gone.map(|entry| entry.address))
    }
}

impl Place {
    pub(super) fn peer(&self, address: IpAddr) -> Peer {
        Peer { connections: self.connections.clone(), id: self.id, address }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.connections.table().open.retain(|entry| entry.id != self.id);
    }
}

impl Peer {
    fn change(&self, change: impl FnOnce(&mut Entry)) {
        let mut table = self.connections.table();
        let moved = table.next();
        if let Some(entry) = table.open.iter_mut().find(|entry| entry.id == self.id) {
            entry.moved = moved;
            change(entry);
        }
    }

    /// Its last request has shown the token, or has not.
    pub(super) fn known(&self, known: bool) {
        self.change(|entry| entry.known = known);
    }

    /// A request of it is at work.
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
