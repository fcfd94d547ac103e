//! The adapter behind a port: the name that stays with it, and how long it holds bytes back.

use std::fs;
use std::path::Path;

use super::device;
use crate::catalogue::PortFinding::{self, AdapterHoldsBack};

/// The name by which the device is found again when it comes back under another number: by-id, else
/// by-path, else the name itself (a link of the user's own is followed afresh each time).
pub fn identity(name: &str) -> String {
    let path = device(name);
    if path.starts_with("/dev/serial") {
        return name.to_owned();
    }
    let Ok(target) = fs::canonicalize(&path) else { return name.to_owned() };
    for kind in ["by-id", "by-path"] {
        let entries = fs::read_dir(Path::new("/dev/serial").join(kind)).into_iter().flatten().flatten();
        let found = entries.filter(|entry| fs::canonicalize(entry.path()).is_ok_and(|to| to == target));
        if let Some(least) = found.filter_map(|entry| entry.file_name().into_string().ok()).min() {
            return format!("{kind}/{least}");
        }
    }
    name.to_owned()
}

/// Sets the adapter's latency timer to 1 ms where that is permitted; the finding if it still holds bytes back for
/// longer.
pub fn quicken(name: &str) -> Option<PortFinding> {
    let target = fs::canonicalize(device(name)).ok()?;
    let device = target.file_name()?.to_str()?.to_owned();
    let timer = Path::new("/sys/bus/usb-serial/devices").join(&device).join("latency_timer");
    let read = || fs::read_to_string(&timer).ok()?.trim().parse::<u32>().ok();
    if read()? > 1 {
        // Not permitted to most: what is read back counts.
        let _ = fs::write(&timer, "1");
    }
    Some(AdapterHoldsBack { device, hold_ms: read().filter(|ms| *ms > 1)? })
}
