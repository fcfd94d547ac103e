//! Rate limit for wrong tokens: each address has a few per minute. The right token is not limited.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};

use dbbd_device::clock;
use dbbd_model::base::units::HostNs;

/// Wrong tokens per network within [`WINDOW_S`] that are answered as wrong. Clients with further ones are asked to
/// wait.
const MAX_WRONG_TOKENS: u32 = 10;
const WINDOW_S: f64 = 60.0;
/// Number of networks that are remembered. The oldest is dropped for a new one.
const MAX_NETWORKS: usize = 1024;

struct WrongTokens {
    network: IpAddr,
    since: HostNs,
    wrong: u32,
}

/// Wrong tokens per network, the oldest first.
#[derive(Default)]
pub(super) struct FailedLogins(VecDeque<WrongTokens>);

/// The network that one user has: the address in IPv4, the first 64 bits in IPv6.
pub(super) fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(ip) => match ip.to_ipv4_mapped() {
            Some(ip) => ip.into(),
            None => Ipv6Addr::from_bits(ip.to_bits() & !u128::from(u64::MAX)).into(),
        },
    }
}

impl FailedLogins {
    /// Counts a wrong token; `true` if too many came from its network.
    pub(super) fn add(&mut self, address: IpAddr) -> bool {
        self.add_at(address, clock::now())
    }

    fn add_at(&mut self, address: IpAddr, now: HostNs) -> bool {
        self.0.retain(|count| now.seconds_since(count.since) < WINDOW_S);
        let network = network(address);
        if let Some(count) = self.0.iter_mut().find(|count| count.network == network) {
            count.wrong += 1;
            return count.wrong > MAX_WRONG_TOKENS;
        }
        self.0.push_back(WrongTokens { network, since: now, wrong: 1 });
        if self.0.len() > MAX_NETWORKS {
            self.0.pop_front();
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().expect("it is an address")
    }

    /// A user of IPv6 has 2^64 addresses: the first four groups are the network.
    #[test]
    fn network_is_an_address_of_four_bytes_or_the_first_half_of_a_longer_one() {
        for (address, expected) in [
            ("192.168.7.9", "192.168.7.9"),
            ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::"),
            ("2001:db8:1:2:ffff:ffff:ffff:ffff", "2001:db8:1:2::"),
            ("2001:db8:1:3::", "2001:db8:1:3::"),
            ("::ffff:192.168.7.9", "192.168.7.9"),
            ("::1", "::"),
        ] {
            assert_eq!(network(ip(address)), ip(expected), "{address}");
        }
    }

    fn at(s: u64) -> HostNs {
        HostNs(s * 1_000_000_000)
    }

    #[test]
    fn eleventh_wrong_token_of_a_network_is_too_many() {
        let mut failed = FailedLogins::default();
        for number in 0..10 {
            assert!(!failed.add_at(ip(&format!("2001:db8::{number}")), at(100)), "{number}");
        }
        assert!(failed.add_at(ip("2001:db8::ffff"), at(100)));
        assert!(!failed.add_at(ip("2001:db8:0:1::"), at(100)));
        assert!(!failed.add_at(ip("192.168.7.9"), at(100)));
    }

    #[test]
    fn wrong_tokens_are_forgotten_after_a_minute() {
        for (later_s, too_many) in [(59, true), (61, false)] {
            let mut failed = FailedLogins::default();
            (0..10).for_each(|_| assert!(!failed.add_at(ip("10.0.0.1"), at(100))));
            assert_eq!(failed.add_at(ip("10.0.0.1"), at(100 + later_s)), too_many, "{later_s}");
        }
    }

    #[test]
    fn oldest_of_too_many_networks_is_dropped() {
        let mut failed = FailedLogins::default();
        for number in 0..=1024_u16 {
            failed.add_at(Ipv6Addr::new(0x2001, 0xdb8, 0, number, 0, 0, 0, 1).into(), at(100));
        }
        assert_eq!(failed.0.len(), 1024);
        assert_eq!(failed.0[0].network, ip("2001:db8:0:1::"));
    }
}
