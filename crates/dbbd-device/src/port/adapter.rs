//! The adapter behind a port: its permanent name, and its latency timer.

use std::path::{Path, PathBuf};
use std::{fmt, fs};

use serialport::{SerialPortInfo, SerialPortType};

use super::PortAddress;
use crate::port::PortFinding::{self, AdapterHoldsBack, NetworkBlurs};

const SERIAL: &str = "/dev/serial";

/// The address by which the device is found again if it returns under another number: by-id, else by-path, else the
/// address itself (a user's own link is resolved each time). Of an adapter that shares its name, by-path comes first.
pub fn identity(address: &PortAddress) -> PortAddress {
    let Some(path) = address.device().filter(|path| !path.starts_with(SERIAL)) else {
        return address.clone();
    };
    let Ok(target) = fs::canonicalize(&path) else { return address.clone() };
    let kinds = if is_named_alone(&target) { ["by-id", "by-path"] } else { ["by-path", "by-id"] };
    let name = kinds
        .into_iter()
        .find_map(|kind| Some(format!("{kind}/{}", link(Path::new(SERIAL), kind, &target)?)));
    name.map_or_else(|| address.clone(), PortAddress::Serial)
}

/// The first link of a kind to a device.
fn link(serial: &Path, kind: &str, target: &Path) -> Option<String> {
    let entries = fs::read_dir(serial.join(kind)).into_iter().flatten().flatten();
    let found = entries.filter(|entry| fs::canonicalize(entry.path()).is_ok_and(|to| to == target));
    found.filter_map(|entry| entry.file_name().into_string().ok()).min()
}

/// Whether the adapter behind a device has a serial number that no other adapter here has.
fn is_named_alone(target: &Path) -> bool {
    let ports = serialport::available_ports().unwrap_or_default();
    let number = |port: &SerialPortInfo| match &port.port_type {
        SerialPortType::UsbPort(usb) => usb.serial_number.clone(),
        SerialPortType::PciPort | SerialPortType::BluetoothPort | SerialPortType::Unknown => None,
    };
    let own = ports.iter().find(|port| Path::new(&port.port_name) == target).and_then(number);
    own.is_some_and(|own| ports.iter().filter(|port| number(port).as_ref() == Some(&own)).count() == 1)
}

/// The device behind a name under `/dev/serial`: two adapters without serial numbers have one name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortDevice {
    target: PathBuf,
    /// The socket where it is plugged in.
    by_path: Option<String>,
    is_named_alone: bool,
}

impl PortDevice {
    /// The device behind an address; `None` if the address is no such name, or nothing is plugged in.
    pub fn behind(address: &PortAddress) -> Option<Self> {
        let name = address.device().filter(|path| path.starts_with(SERIAL))?;
        Self::of_link(&name, Path::new(SERIAL))
    }

    fn of_link(name: &Path, serial: &Path) -> Option<Self> {
        let target = fs::canonicalize(name).ok()?;
        let by_path = link(serial, "by-path", &target);
        Some(Self { by_path, is_named_alone: is_named_alone(&target), target })
    }

    /// The finding that the name is this device's and was another's.
    pub fn instead_of(&self, began: &Self, port: &str) -> PortFinding {
        PortFinding::OtherDevice { port: port.into(), began: began.to_string(), now: self.to_string() }
    }

    /// Whether a device under the same name may be this one: it is in the same socket, or its name is its own.
    pub fn may_be(&self, other: &Self) -> bool {
        match (&self.by_path, &other.by_path) {
            (Some(socket), Some(other)) if socket == other => true,
            _ if self.is_named_alone && other.is_named_alone => true,
            (Some(_), Some(_)) => false,
            _ => self.target == other.target,
        }
    }
}

impl fmt::Display for PortDevice {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.by_path {
            Some(socket) => write!(out, "{} at {socket}", self.target.display()),
            None => write!(out, "{}", self.target.display()),
        }
    }
}

/// The latency timer of the adapter behind a device, on systems that show it.
fn timer(device: &Path) -> Option<PathBuf> {
    let target = fs::canonicalize(device).ok()?;
    Some(Path::new("/sys/bus/usb-serial/devices").join(target.file_name()?).join("latency_timer"))
}

pub(super) fn latency_ms(device: &Path) -> Option<u32> {
    fs::read_to_string(timer(device)?).ok()?.trim().parse().ok()
}

/// The finding about inaccurate time stamps of a line. The timer of a USB adapter is set to 1 ms first, if permitted.
pub fn blur(address: &PortAddress) -> Option<PortFinding> {
    let device = address.device();
    let Some(device) = device else {
        return matches!(address, PortAddress::Tcp(_) | PortAddress::Rfc2217(_))
            .then(|| NetworkBlurs { port: address.to_string() });
    };
    if latency_ms(&device)? > 1 {
        // Most users are not permitted: the value that is read back counts.
        let _ = fs::write(timer(&device)?, "1");
    }
    let name = fs::canonicalize(&device).ok()?.file_name()?.to_string_lossy().into_owned();
    Some(AdapterHoldsBack { device: name, hold_ms: latency_ms(&device).filter(|ms| *ms > 1)? })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use dbbd_model::diagnostic::Finding;
    use std::os::unix::fs::symlink;

    /// Two adapters without a serial number: the name passes from one to the other, as udev has it.
    #[test]
    fn a_name_that_passed_to_a_twin_is_another_device() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path();
        fs::create_dir(at.join("by-path")).unwrap();
        for device in ["ttyUSB0", "ttyUSB1", "ttyUSB2", "ttyS0"] {
            fs::write(at.join(device), "").unwrap();
        }
        let name = at.join("by-id-of-both");
        let behind = |device: &str, socket: &str| {
            _ = fs::remove_file(&name);
            symlink(at.join(device), &name).unwrap();
            if !socket.is_empty() {
                _ = fs::remove_file(at.join("by-path").join(socket));
                symlink(at.join(device), at.join("by-path").join(socket)).unwrap();
            }
            PortDevice::of_link(&name, at).unwrap()
        };
        let began = behind("ttyUSB0", "usb-1");
        assert_eq!(
            began.to_string(),
            format!("{} at usb-1", at.join("ttyUSB0").canonicalize().unwrap().display())
        );
        let twin = behind("ttyUSB1", "usb-2");
        assert!(!began.may_be(&twin));
        let finding = twin.instead_of(&began, "by-id/both");
        assert!(finding.code().as_str() == "W0227" && finding.to_string().contains("usb-2 now"), "{finding}");
        // Back in its socket under another number.
        assert!(began.may_be(&behind("ttyUSB2", "usb-1")));
        // Without a socket the device itself counts.
        let plain = behind("ttyS0", "");
        assert!(plain.may_be(&behind("ttyS0", "")) && !plain.may_be(&began));
        let alone =
            |device: &str, socket: &str| PortDevice { is_named_alone: true, ..behind(device, socket) };
        assert!(alone("ttyUSB0", "usb-1").may_be(&alone("ttyUSB1", "usb-2")));
        assert_eq!(PortDevice::of_link(&at.join("none"), at), None);
    }
}
