//! The adapter behind a port: its permanent name, and its latency timer.

use std::fs;
use std::path::{Path, PathBuf};

use super::PortAddress;
use crate::port::PortFinding::{self, AdapterHoldsBack, NetworkBlurs};

/// The address by which the device is found again if it returns under another number: by-id, else by-path, else the
/// address itself (a user's own link is resolved each time).
pub fn identity(address: &PortAddress) -> PortAddress {
    let Some(path) = address.device().filter(|path| !path.starts_with("/dev/serial")) else {
        return address.clone();
    };
    let Ok(target) = fs::canonicalize(&path) else { return address.clone() };
    for kind in ["by-id", "by-path"] {
        let entries = fs::read_dir(Path::new("/dev/serial").join(kind)).into_iter().flatten().flatten();
        let found = entries.filter(|entry| fs::canonicalize(entry.path()).is_ok_and(|to| to == target));
        if let Some(least) = found.filter_map(|entry| entry.file_name().into_string().ok()).min() {
            return PortAddress::Serial(format!("{kind}/{least}"));
        }
    }
    address.clone()
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
