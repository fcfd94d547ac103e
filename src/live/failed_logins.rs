//! Rate limit for wrong tokens: each address has a few attempts per minute.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};

use dbbd_device::clock;
use dbbd_model::base::units::HostNs;

/// Wrong tokens per network within [`WINDOW_S`]. Further attempts are refused without a comparison.
const MOST: u32 = 10;
const WINDOW_S: f64 = 60.0;
/// Networks that are remembered. The oldest is dropped for a new one.
const MOST_NETWORKS: usize = 1024;

struct Count {
    network: IpAddr,
    since: HostNs,
    wrong: u32,
}

/// Wrong tokens per network, the oldest first.
#[derive(Default)]
pub(super) struct FailedLogins(VecDeque<Count>);

/// The network that one user has: the address in IPv4, the first 64 bits in IPv6.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(ip) => match ip.to_ipv4_mapped() {
            Some(ip) => ip.into(),
            None => Ipv6Addr::from_bits(ip.to_bits() & !u128::from(u64::MAX)).into(),
        },
    }
}

impl FailedLogins {
    pub(super) fn is_limited(&mut self, address: IpAddr) -> bool {
        let now = clock::now();
        self.0.retain(|count| now.seconds_since(count.since) < WINDOW_S);
        let network = network(address);
        self.0.iter().any(|count| count.network == network && count.wrong >= MOST)
    }

    pub(super) fn add(&mut self, address: IpAddr) {
        let network = network(address);
        match self.0.iter_mut().find(|count| count.network == network) {
            Some(count) => count.wrong += 1,
            None => self.0.push_back(Count { network, since: clock::now(), wrong: 1 }),
        }
        if self.0.len() > MOST_NETWORKS {
            self.0.pop_front();
        }
    }
}
