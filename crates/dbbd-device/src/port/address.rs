//! Addresses of ports.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::port::PortFinding::{self, AddressHost, AddressNumber, AddressScheme, NoAddress};

/// Location of a bar.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortAddress {
    /// A serial port of this computer: a device, `COM3`, or `by-id/..` and `by-path/..` under `/dev/serial`.
    Serial(String),
    /// A serial server that passes bytes on.
    Tcp(NetworkAddress),
    /// A serial server whose line is set over the network (RFC 2217).
    Rfc2217(NetworkAddress),
    /// A simulated cell.
    Sim,
}

/// A host by name or number, and a TCP port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkAddress {
    pub host: String,
    pub port: u16,
}

impl PortAddress {
    pub fn device(&self) -> Option<PathBuf> {
        let Self::Serial(name) = self else { return None };
        let stays = name.starts_with("by-id/") || name.starts_with("by-path/");
        Some(if stays { Path::new("/dev/serial").join(name) } else { PathBuf::from(name) })
    }

    /// Whether a device that disappeared may return at this address. The number of a closed pseudo-terminal is
    /// reused by another program.
    pub fn may_return(&self) -> bool {
        !self.device().is_some_and(|device| device.starts_with("/dev/pts"))
    }

    /// Whether a serial port is plugged in. A server is checked when it is opened.
    pub fn is_present(&self) -> bool {
        match self.device() {
            None => true,
            Some(device) if cfg!(unix) => device.exists(),
            // A COM port has no file.
            Some(device) => {
                let ports = serialport::available_ports().unwrap_or_default();
                let name = device.display().to_string();
                ports.iter().any(|port| port.port_name.eq_ignore_ascii_case(name.trim_start_matches(r"\\.\")))
            }
        }
    }
}

impl FromStr for PortAddress {
    type Err = PortFinding;

    fn from_str(text: &str) -> Result<Self, PortFinding> {
        match text.split_once("://") {
            None if text.is_empty() => Err(NoAddress),
            None if text == "sim" => Ok(Self::Sim),
            None => Ok(Self::Serial(text.into())),
            Some(("tcp", rest)) => Ok(Self::Tcp(rest.parse()?)),
            Some(("rfc2217", rest)) => Ok(Self::Rfc2217(rest.parse()?)),
            Some((scheme, _)) => Err(AddressScheme { scheme: scheme.into() }),
        }
    }
}

impl FromStr for NetworkAddress {
    type Err = PortFinding;

    /// `HOST:PORT`, an IPv6 number in brackets.
    fn from_str(text: &str) -> Result<Self, PortFinding> {
        let missing = || AddressNumber { address: text.into() };
        let (host, port) = text.trim_end_matches('/').rsplit_once(':').ok_or_else(missing)?;
        let inner = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
        let bare = inner.unwrap_or(host);
        let odd = |c: char| c.is_whitespace() || c.is_control() || "/[]@?#".contains(c);
        if bare.is_empty() || bare.contains(odd) || (inner.is_none() && bare.contains(':')) {
            return Err(AddressHost { address: text.into() });
        }
        let port = port.parse().map_err(|_| missing())?;
        Ok(Self { host: bare.into(), port })
    }
}

impl fmt::Display for PortAddress {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(name) => out.write_str(name),
            Self::Tcp(address) => write!(out, "tcp://{address}"),
            Self::Rfc2217(address) => write!(out, "rfc2217://{address}"),
            Self::Sim => out.write_str("sim"),
        }
    }
}

impl fmt::Display for NetworkAddress {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port } = self;
        if host.contains(':') { write!(out, "[{host}]:{port}") } else { write!(out, "{host}:{port}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::diagnostic::Finding;

    #[test]
    fn addresses_round_trip() {
        for text in
            ["/dev/ttyUSB0", "COM3", "by-id/usb-x", "sim", "tcp://10.0.0.7:4001", "rfc2217://[::1]:2217"]
        {
            let address: PortAddress = text.parse().unwrap();
            assert_eq!(address.to_string(), text);
        }
        let device = "by-id/usb-x".parse::<PortAddress>().unwrap().device();
        assert_eq!(device, Some(PathBuf::from("/dev/serial/by-id/usb-x")));
    }

    #[test]
    fn pseudo_terminal_does_not_return() {
        let may_return = |text: &str| text.parse::<PortAddress>().unwrap().may_return();
        assert!(!may_return("/dev/pts/4"));
        assert!(["bar", "/dev/ttyUSB0", "COM3", "tcp://10.0.0.7:4001"].into_iter().all(may_return));
    }

    #[test]
    fn invalid_addresses_are_refused() {
        for text in
            ["", "http://a:1", "tcp://a", "tcp://:1", "tcp://a:65536", "tcp://::1:5", "tcp://a b:1", "tcp://"]
        {
            assert_eq!(text.parse::<PortAddress>().unwrap_err().code().as_str(), "E0230", "{text}");
        }
    }

    #[test]
    fn numbers_of_ipv6_stand_in_brackets() {
        let address: NetworkAddress = "[fe80::1]:4001".parse().unwrap();
        assert_eq!((address.host.as_str(), address.port), ("fe80::1", 4001));
        assert_eq!(address.to_string(), "[fe80::1]:4001");
        let address: NetworkAddress = "server:65535/".parse().unwrap();
        assert_eq!((address.host.as_str(), address.port), ("server", 65_535));
        for text in
            ["[fe80::1/64]:4001", "[fe80::1:4001", "fe80::1]:4001", "fe80::1:4001", "[]:1", "a/b:1", "a@b:1"]
        {
            assert!(text.parse::<NetworkAddress>().is_err(), "{text}");
        }
    }
}
