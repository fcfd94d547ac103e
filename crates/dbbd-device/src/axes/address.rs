//! Addresses of controllers that publish their axes.

use std::fmt;
use std::net::SocketAddr;
use std::str::FromStr;

use super::{AxesProtocol, rtde};
use crate::axes::AxesFinding;
use crate::port::NetworkAddress;

#[derive(Clone, Debug, PartialEq)]
pub enum AxesAddress {
    /// `rsi://ADDR:PORT[?answer=zero]`: listen here for the controller's datagrams.
    Rsi { listen: SocketAddr, answer: RsiAnswer },
    /// `rtde://HOST[:30004][?hz=RATE]`: connect to the controller.
    Rtde { server: NetworkAddress, rate_hz: f64 },
}

/// Answers to an RSI controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RsiAnswer {
    /// None, for `ONLYSEND` TRUE.
    Nothing,
    /// A correction of zero to each datagram.
    Zero,
}

/// Packages per second that every controller can send.
const RATE_HZ: f64 = 125.0;

impl AxesAddress {
    pub fn protocol(&self) -> AxesProtocol {
        match self {
            Self::Rsi { .. } => AxesProtocol::Rsi,
            Self::Rtde { .. } => AxesProtocol::Rtde,
        }
    }
}

impl FromStr for AxesAddress {
    type Err = AxesFinding;

    fn from_str(text: &str) -> Result<Self, AxesFinding> {
        let wrong = || AxesFinding::NoAddress { address: text.into() };
        let (scheme, rest) = text.split_once("://").ok_or_else(wrong)?;
        let (place, option) =
            rest.split_once('?').map_or((rest, None), |(place, option)| (place, Some(option)));
        match scheme {
            "rsi" => {
                let answer = match option {
                    None => RsiAnswer::Nothing,
                    Some("answer=zero") => RsiAnswer::Zero,
                    Some(_) => return Err(wrong()),
                };
                Ok(Self::Rsi { listen: place.parse().map_err(|_| wrong())?, answer })
            }
            "rtde" => {
                let rate = option.map(|option| option.strip_prefix("hz=")?.parse::<f64>().ok());
                let rate_hz = rate.unwrap_or(Some(RATE_HZ)).filter(|hz| (1.0..=500.0).contains(hz));
                let place = place.trim_end_matches('/');
                let whole = if place.ends_with(']') || !place.contains(':') {
                    format!("{place}:{}", rtde::PORT)
                } else {
                    place.to_owned()
                };
                let server = whole.parse().map_err(|_| wrong())?;
                Ok(Self::Rtde { server, rate_hz: rate_hz.ok_or_else(wrong)? })
            }
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for AxesAddress {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rsi { listen, answer: RsiAnswer::Nothing } => write!(out, "rsi://{listen}"),
            Self::Rsi { listen, answer: RsiAnswer::Zero } => write!(out, "rsi://{listen}?answer=zero"),
            Self::Rtde { server, rate_hz } => write!(out, "rtde://{server}?hz={rate_hz}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(text: &str) -> Option<String> {
        text.parse::<AxesAddress>().ok().map(|address| address.to_string())
    }

    #[test]
    fn port_and_rate_of_rtde_have_defaults() {
        for (text, expected) in [
            ("rtde://10.0.0.5", "rtde://10.0.0.5:30004?hz=125"),
            ("rtde://ur10/", "rtde://ur10:30004?hz=125"),
            ("rtde://ur10:30003", "rtde://ur10:30003?hz=125"),
            ("rtde://[fe80::1]", "rtde://[fe80::1]:30004?hz=125"),
            ("rtde://[fe80::1]:5?hz=500", "rtde://[fe80::1]:5?hz=500"),
            ("rtde://ur10?hz=1", "rtde://ur10:30004?hz=1"),
        ] {
            assert_eq!(shown(text).as_deref(), Some(expected), "{text}");
            assert_eq!(shown(expected).as_deref(), Some(expected));
        }
    }

    #[test]
    fn rsi_listens_and_may_answer() {
        for text in ["rsi://0.0.0.0:49152", "rsi://[::1]:49152?answer=zero"] {
            let address: AxesAddress = text.parse().unwrap();
            assert_eq!((address.to_string().as_str(), address.protocol()), (text, AxesProtocol::Rsi));
        }
        assert_eq!("rtde://ur10".parse::<AxesAddress>().unwrap().protocol(), AxesProtocol::Rtde);
    }

    #[test]
    fn invalid_addresses_are_refused() {
        for text in [
            "",
            "ur10",
            "udp://ur10",
            "rsi://kuka:49152",
            "rsi://0.0.0.0",
            "rsi://0.0.0.0:1?answer=one",
            "rsi://[fe80::1/64]:49152",
            "rtde://",
            "rtde://ur10?hz=0.99",
            "rtde://ur10?hz=500.1",
            "rtde://ur10?hz=fast",
            "rtde://ur10?rate=5",
            "rtde://fe80::1",
            "rtde://[fe80::1/64]",
        ] {
            assert_eq!(shown(text), None, "{text}");
        }
    }
}
