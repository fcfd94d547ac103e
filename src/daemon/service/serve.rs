//! The service process: start, web thread, watchdog, shutdown.

use dbbd_model::base::InternalFinding;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use std::{io, panic, process, thread};

use tokio::sync::watch;

use super::config::{Endpoint, ServiceConfig};
use super::log::{LogLevel, ServiceLog};
use super::{ServiceParts, Supervisor};
use crate::daemon::signals;
use crate::live::ServiceFinding::NotServing;
use crate::live::{self, Access, Site, State};
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;

/// Interval of the main loop, s.
const TICK_S: f64 = 0.2;
/// The web thread is alive if its last heartbeat is not older than this, s.
const ALIVE_S: f64 = 5.0;
/// Blocking requests of clients at a time.
const MAX_BLOCKING: usize = 16;
/// Name of the web threads.
const WEB: &str = "web";

/// Makes a panic abort the process: a recorder without one of its threads would only seem to work. Web threads are the
/// exception: their panic loses a request, not the run.
pub fn abort_on_panic() {
    let report = panic::take_hook();
    panic::set_hook(Box::new(move |panicked| {
        report(panicked);
        if thread::current().name() != Some(WEB) {
            process::abort();
        }
    }));
}

/// Serves until SIGINT or SIGTERM, which also end the run in progress.
pub fn serve(
    mut config: ServiceConfig,
    log: Arc<dyn ServiceLog>,
    parts: ServiceParts,
) -> Result<(), Diagnostic> {
    let (address, access) = log_endpoint(&mut config.endpoint, &*log);
    let signalled = signals::stop_on_signal()?;
    let (supervisor, over) = Supervisor::new(config, Arc::clone(&log), parts).map_err(no_system)?;
    let supervisor = Arc::new(supervisor);
    #[cfg(feature = "archive")]
    super::archiving::start(&supervisor, over).map_err(no_system)?;
    #[cfg(not(feature = "archive"))]
    drop(over);
    let (stop, stopped) = watch::channel(false);
    let site = live::cell_site(supervisor.clone(), access, stopped.clone());
    let web = WebServer::new(site, Arc::clone(&log), address, stopped);
    let served = main_loop(&web, &signalled, || {
        let state = supervisor.tick();
        // The run is more important than pages that hang.
        ServiceTick { status: state.name(), keep_alive: state == State::Running }
    });
    notify("STOPPING=1");
    stop.send_replace(true);
    supervisor.end();
    close(served?, &*log)
}

/// Serves the pages of a plant until SIGINT or SIGTERM.
#[cfg(feature = "archive")]
pub fn serve_plant(
    mut endpoint: Endpoint,
    log: Arc<dyn ServiceLog>,
    plant: Arc<dbbd_plant::PlantPages>,
) -> Result<(), Diagnostic> {
    let (address, access) = log_endpoint(&mut endpoint, &*log);
    let signalled = signals::stop_on_signal()?;
    let (stop, stopped) = watch::channel(false);
    let site = live::plant_site(plant, access, Arc::new(super::log::RateLimitedLog::new(Arc::clone(&log))))?;
    let web = WebServer::new(site, Arc::clone(&log), address, stopped);
    let served = main_loop(&web, &signalled, || ServiceTick { status: "serving", keep_alive: false });
    notify("STOPPING=1");
    stop.send_replace(true);
    close(served?, &*log)
}

/// Logs the risks of the address and of the user of the process.
fn log_endpoint(endpoint: &mut Endpoint, log: &dyn ServiceLog) -> (SocketAddr, Arc<Access>) {
    let address = endpoint.address;
    if !address.ip().is_loopback() {
        log.event(LogLevel::Warning, "open_to_the_network_without_encryption", &[("address", &address)]);
    }
    if is_root() {
        log.event(LogLevel::Warning, "running_as_root", &[("help", &"docs/how-to/service.md")]);
    }
    let users = endpoint.take_users();
    let access = Access::new(address.ip(), &endpoint.hosts, users);
    (address, Arc::new(access.behind(std::mem::take(&mut endpoint.proxies))))
}

fn close(served: WebThread, log: &dyn ServiceLog) -> Result<(), Diagnostic> {
    match served.join() {
        Ok(served) => served?,
        Err(_) => log.event(LogLevel::Error, "web_died", &[]),
    }
    log.event(LogLevel::Info, "stopped", &[]);
    Ok(())
}

type WebThread = thread::JoinHandle<Result<(), Diagnostic>>;

struct ServiceTick {
    status: &'static str,
    /// Whether the service manager must not restart the process although the pages hang.
    keep_alive: bool,
}

/// Updates the state, serves the watchdog of the service manager, and restarts the web thread after a panic. Returns
/// the web thread on a signal.
fn main_loop(
    web: &WebServer,
    signalled: &AtomicBool,
    tick: impl Fn() -> ServiceTick,
) -> Result<WebThread, Diagnostic> {
    let mut served = web.start().map_err(no_system)?;
    let mut notified = None;
    let (watchdog_s, mut served_at) = (watchdog_s(), clock::now());
    while !signalled.load(Ordering::Relaxed) {
        let ServiceTick { status, keep_alive } = tick();
        if notified.replace(status) != Some(status) {
            notify(&format!("STATUS={status}"));
        }
        if served.is_finished() {
            match served.join() {
                // The web thread returns by itself only if it cannot start.
                Ok(ended) => ended?,
                Err(_) => web.log.event(LogLevel::Error, "web_died", &[]),
            }
            served = web.start().map_err(no_system)?;
        }
        let now = clock::now();
        let alive = now.seconds_since(HostNs(web.beat.load(Ordering::Relaxed))) < ALIVE_S;
        if (alive || keep_alive) && watchdog_s.is_some_and(|s| now.seconds_since(served_at) >= s) {
            notify("WATCHDOG=1");
            served_at = now;
        }
        clock::sleep(TICK_S);
    }
    Ok(served)
}

/// The web server and its threads.
#[derive(Clone)]
struct WebServer {
    site: Site,
    log: Arc<dyn ServiceLog>,
    /// The address, with the port that the system assigned once it is bound.
    address: Arc<Mutex<SocketAddr>>,
    /// Time of the last heartbeat, ns.
    beat: Arc<AtomicU64>,
    stopped: watch::Receiver<bool>,
}

impl WebServer {
    fn new(
        site: Site,
        log: Arc<dyn ServiceLog>,
        address: SocketAddr,
        stopped: watch::Receiver<bool>,
    ) -> Self {
        let beat = Arc::new(AtomicU64::new(clock::now().0));
        Self { site, log, address: Arc::new(Mutex::new(address)), beat, stopped }
    }

    fn start(&self) -> io::Result<WebThread> {
        let web = self.clone();
        thread::Builder::new().name(WEB.into()).spawn(move || web.run())
    }

    fn run(self) -> Result<(), Diagnostic> {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let builder = builder.enable_all().thread_name(WEB).max_blocking_threads(MAX_BLOCKING);
        let runtime = builder.build().map_err(no_system)?;
        let Self { site, log, address, beat, stopped } = self;
        let wanted = *lock(&address);
        let served = runtime.block_on(async {
            tokio::spawn(async move {
                loop {
                    beat.store(clock::now().0, Ordering::Relaxed);
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            });
            let ready = |given: SocketAddr| {
                *lock(&address) = given;
                log.event(LogLevel::Info, "listening", &[("address", &format!("http://{given}/"))]);
                notify("READY=1");
            };
            live::serve(wanted, site, stopped, ready).await
        });
        // A request that never returns must not delay the shutdown.
        runtime.shutdown_timeout(Duration::from_secs(1));
        served.map_err(|error| NotServing { address: wanted.to_string(), why: error.to_string() }.into())
    }
}

fn no_system(error: io::Error) -> InternalFinding {
    InternalFinding::NoSystem { why: error.to_string() }
}

/// Whether the process has root rights, which the service does not need.
#[cfg(target_os = "linux")]
fn is_root() -> bool {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0)
}

#[cfg(not(target_os = "linux"))]
fn is_root() -> bool {
    false
}

/// Notifies the service manager over its datagram socket (sd_notify), as `READY=1`.
#[cfg(target_os = "linux")]
fn notify(text: &str) {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::net::{SocketAddr, UnixDatagram};

    let Some(path) = std::env::var_os("NOTIFY_SOCKET") else { return };
    let address = match path.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name),
        None => SocketAddr::from_pathname(&path),
    };
    // Fails without a service manager that listens.
    if let (Ok(address), Ok(socket)) = (address, UnixDatagram::unbound()) {
        let _ = socket.send_to_addr(text.as_bytes(), &address);
    }
}

#[cfg(not(target_os = "linux"))]
fn notify(_: &str) {}

/// Interval for the watchdog of the service manager, s: half of its timeout.
fn watchdog_s() -> Option<f64> {
    let allowed_us: f64 = std::env::var("WATCHDOG_USEC").ok()?.parse().ok()?;
    (allowed_us > 0.0).then_some(allowed_us * 1e-6 / 2.0)
}
