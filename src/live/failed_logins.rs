//! Rate limit for wrong tokens: each address has a few attempts per minute.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv6Addr};

use dbbd_device::clock;
use dbbd_model::base::units::HostNs;

/// Wrong tokens per network within [`WINDOW_S`]. Further attempts are refused without a comparison.
const MAX_WRONG_TOKENS: u32 = 10;
const WINDOW_S: f64 = 60.0;
/// Networks that are remembered. The oldest is dropped for a new one.
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
        self.0.iter().any(|count| count.network == network && count.wrong >= MAX_WRONG_TOKENS)
    }

    pub(super) fn add(&mut self, address: IpAddr) {
        let network = network(address);
        match self.0.iter_mut().find(|count| count.network == network) {
            Some(count) => count.wrong += 1,
            None => self.0.push_back(WrongTokens { network, since: clock::now(), wrong: 1 }),
        }
        if self.0.len() > MAX_NETWORKS {
            self.0.pop_front();
        }
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

    #[test]
    fn tenth_wrong_token_of_a_network_is_its_last() {
        let mut failed = FailedLogins::default();
        for number in 0..10 {
            assert!(!failed.is_limited(ip("2001:db8::1")), "{number}");
            failed.add(ip(&format!("2001:db8::{number}")));
        }
        assert!(failed.is_limited(ip("2001:db8::ffff")));
        assert!(!failed.is_limited(ip("2001:db8:0:1::")));
        assert!(!failed.is_limited(ip("192.168.7.9")));
    }

    #[test]
    fn wrong_tokens_are_forgotten_after_a_minute() {
        let mut failed = FailedLogins::default();
        let ago = |s: u64| HostNs(clock::now().0.saturating_sub(s * 1_000_000_000));
        for (since_s, limited) in [(59, true), (61, false)] {
            // The clock of the host may have begun less than a minute ago.
            if ago(since_s).0 > 0 {
                failed.0 = [WrongTokens { network: ip("10.0.0.1"), since: ago(since_s), wrong: 10 }].into();
                assert_eq!(failed.is_limited(ip("10.0.0.1")), limited, "{since_s}");
            }
        }
    }

    #[test]
    fn oldest_of_too_many_networks_is_dropped() {
        let mut failed = FailedLogins::default();
        for number in 0..=1024_u16 {
            failed.add(Ipv6Addr::new(0x2001, 0xdb8, 0, number, 0, 0, 0, 1).into());
        }
        assert_eq!(failed.0.len(), 1024);
        assert_eq!(failed.0[0].network, ip("2001:db8:0:1::"));
    }
}
