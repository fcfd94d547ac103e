//! Wrong tokens: how many came from where, so that they cannot be tried by the thousand.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};

use crate::base::clock;
use crate::base::units::HostNs;

/// Wrong tokens that are compared within [`WINDOW_S`] from one address; more are refused unseen.
const MOST: u32 = 10;
const WINDOW_S: f64 = 60.0;
/// Addresses that are remembered; the oldest is forgotten for one more.
const MOST_ADDRESSES: usize = 1024;

struct Count {
    address: IpAddr,
    since: HostNs,
    wrong: u32,
}

/// The counts, the oldest first.
#[derive(Default)]
pub(super) struct Guesses(VecDeque<Count>);

impl std::fmt::Debug for Guesses {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "Guesses({})", self.0.len())
    }
}

/// A user has a whole network of 64 bits in IPv6.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(ip) => match ip.to_ipv4_mapped() {
            Some(ip) => ip.into(),
            None => Ipv6Addr::from_bits(ip.to_bits() & !u128::from(u64::MAX)).into(),
        },
    }
}

impl Guesses {
    /// Whether no more are looked at from there for now.
    pub(super) fn too_many(&mut self, address: IpAddr) -> bool {
        let now = clock::now();
        self.0.retain(|count| now.seconds_since(count.since) < WINDOW_S);
        let address = network(address);
        self.0.iter().any(|count| count.address == address && count.wrong >= MOST)
    }

    /// One more came from there.
    pub(super) fn wrong(&mut self, address: IpAddr) {
        let address = network(address);
        match self.0.iter_mut().find(|count| count.address == address) {
            Some(count) => count.wrong += 1,
            None => self.0.push_back(Count { address, since: clock::now(), wrong: 1 }),
        }
        if self.0.len() > MOST_ADDRESSES {
            self.0.pop_front();
        }
    }
}
