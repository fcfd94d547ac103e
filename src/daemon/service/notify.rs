//! Words to the service manager, over the datagram socket that it names (sd_notify).

/// Says something such as `READY=1`; nothing where there is no service manager.
#[cfg(target_os = "linux")]
pub(super) fn notify(text: &str) {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::net::{SocketAddr, UnixDatagram};

    let Some(path) = std::env::var_os("NOTIFY_SOCKET") else { return };
    let address = match path.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name),
        None => SocketAddr::from_pathname(&path),
    };
    // A service manager that does not listen is none.
    if let (Ok(address), Ok(socket)) = (address, UnixDatagram::unbound()) {
        let _ = socket.send_to_addr(text.as_bytes(), &address);
    }
}

/// Says nothing: there is no such service manager here.
#[cfg(not(target_os = "linux"))]
pub(super) fn notify(_: &str) {}

/// How often the service manager wants a sign of life, s: half of what it allows.
pub(super) fn watchdog_s() -> Option<f64> {
    let allowed_us: f64 = std::env::var("WATCHDOG_USEC").ok()?.parse().ok()?;
    (allowed_us > 0.0).then_some(allowed_us * 1e-6 / 2.0)
}
