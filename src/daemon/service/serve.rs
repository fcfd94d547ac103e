//! The service from its first word to its last: runtime, signals, sign of life.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use std::{io, panic, process, thread};

use tokio::sync::watch;

use super::archiving;
use super::config::{Config, Door};
#[cfg(feature = "archive")]
use super::log::Warnings;
use super::log::{Level, Log};
use super::notify::{notify, watchdog_s};
use super::state::Supervisor;
use super::trial_cell::Bench;
use crate::base::clock;
use crate::base::sync::lock;
use crate::base::units::HostNs;
use crate::catalogue::ServiceFinding::{self, NoSystem, NotServing};
use crate::daemon::signals;
use crate::diagnostic::Diagnostic;
use crate::live::{self, Access, Site, State};

/// How often the state is looked at, s.
const LOOK_S: f64 = 0.2;
/// The pages' thread counts as alive when it moved within so many seconds.
const ALIVE_S: f64 = 5.0;

/// Questions of clients that wait for disk or device at a time.
const MOST_WAITING: usize = 16;

/// Name of the threads that answer clients. A panic on any other thread ends the process.
const WEB: &str = "web";

/// Ends the process with a thread that panics: a recorder without one of its threads would only look alive. Threads
/// that answer clients may go: what they did is lost, the run is not.
pub fn abort_on_panic() {
    let report = panic::take_hook();
    panic::set_hook(Box::new(move |panicked| {
        report(panicked);
        if thread::current().name() != Some(WEB) {
            process::abort();
        }
    }));
}

/// Serves until SIGINT or SIGTERM; a run that is on then ends as it should. `bench` makes the cell of the
/// port `sim`.
///
/// # Errors
/// When the address cannot be had or the system gives no threads.
pub fn serve(mut config: Config, log: Arc<dyn Log>, bench: Option<Bench>) -> Result<(), Diagnostic> {
    let (address, access) = open(&mut config.door, &*log);
    let signalled = signals::stop_on_signal()?;
    let (supervisor, over) = Supervisor::new(config, Arc::clone(&log), bench).map_err(no_system)?;
    let supervisor = Arc::new(supervisor);
    archiving::start(&supervisor, over).map_err(no_system)?;
    let (stop, stopped) = watch::channel(false);
    let site = live::cell_site(supervisor.clone(), access, stopped.clone());
    let web = Web::new(site, Arc::clone(&log), address, stopped);
    let served = look(&web, &signalled, || {
        let state = supervisor.tick();
        // A run is worth more than pages that hang.
        Look { status: state.name(), goes_on: state == State::Running }
    });
    notify("STOPPING=1");
    stop.send_replace(true);
    supervisor.end();
    close(served?, &*log)
}

/// Serves the page of a plant until SIGINT or SIGTERM.
///
/// # Errors
/// When the address cannot be had or the system gives no threads.
#[cfg(feature = "archive")]
pub fn serve_plant(mut door: Door, log: Arc<dyn Log>, plant: Arc<dyn live::Plant>) -> Result<(), Diagnostic> {
    let (address, access) = open(&mut door, &*log);
    let signalled = signals::stop_on_signal()?;
    let (stop, stopped) = watch::channel(false);
    let site = live::plant_site(plant, access, Arc::new(Warnings::new(Arc::clone(&log))))?;
    let web = Web::new(site, Arc::clone(&log), address, stopped);
    let served = look(&web, &signalled, || Look { status: "serving", goes_on: false });
    notify("STOPPING=1");
    stop.send_replace(true);
    close(served?, &*log)
}

/// Where it listens and who may ask; the log has what is dangerous about it.
fn open(door: &mut Door, log: &dyn Log) -> (SocketAddr, Arc<Access>) {
    let address = door.address;
    if !address.ip().is_loopback() {
        log.say(Level::Warning, "open_to_the_network_without_encryption", &[("address", &address)]);
    }
    if is_root() {
        log.say(Level::Warning, "running_as_root", &[("help", &"docs/how-to/service.md")]);
    }
    (address, Arc::new(Access::new(address.ip(), &door.hosts, door.token.take())))
}

fn close(served: Served, log: &dyn Log) -> Result<(), Diagnostic> {
    match served.join() {
        Ok(served) => served?,
        Err(_) => log.say(Level::Error, "web_died", &[]),
    }
    log.say(Level::Info, "stopped", &[]);
    Ok(())
}

type Served = thread::JoinHandle<Result<(), Diagnostic>>;

/// What a look at the state finds.
struct Look {
    status: &'static str,
    /// Whether it must go on although the pages hang.
    goes_on: bool,
}

/// Keeps the state up to date, notifies the service manager, and starts the web's thread again when it died. Returns
/// that thread when all is to end.
fn look(web: &Web, signalled: &AtomicBool, tick: impl Fn() -> Look) -> Result<Served, Diagnostic> {
    let mut served = web.start().map_err(no_system)?;
    let mut notified = None;
    let (pause_s, mut signed) = (watchdog_s(), clock::now());
    while !signalled.load(Ordering::Relaxed) {
        let Look { status, goes_on } = tick();
        if notified.replace(status) != Some(status) {
            notify(&format!("STATUS={status}"));
        }
        if served.is_finished() {
            match served.join() {
                // It ends by itself only where it cannot begin.
                Ok(ended) => ended?,
                Err(_) => web.log.say(Level::Error, "web_died", &[]),
            }
            served = web.start().map_err(no_system)?;
        }
        let now = clock::now();
        let alive = now.seconds_since(HostNs(web.beat.load(Ordering::Relaxed))) < ALIVE_S;
        if (alive || goes_on) && pause_s.is_some_and(|pause_s| now.seconds_since(signed) >= pause_s) {
            notify("WATCHDOG=1");
            signed = now;
        }
        clock::sleep(LOOK_S);
    }
    Ok(served)
}

/// What answers clients, on threads of its own.
#[derive(Clone)]
struct Web {
    site: Site,
    log: Arc<dyn Log>,
    /// Where it listens: with the port that the system gave, once it has.
    address: Arc<Mutex<SocketAddr>>,
    /// When its loop was last alive.
    beat: Arc<AtomicU64>,
    stopped: watch::Receiver<bool>,
}

impl Web {
    fn new(site: Site, log: Arc<dyn Log>, address: SocketAddr, stopped: watch::Receiver<bool>) -> Self {
        let beat = Arc::new(AtomicU64::new(clock::now().0));
        Self { site, log, address: Arc::new(Mutex::new(address)), beat, stopped }
    }

    fn start(&self) -> io::Result<Served> {
        let web = self.clone();
        thread::Builder::new().name(WEB.into()).spawn(move || web.run())
    }

    fn run(self) -> Result<(), Diagnostic> {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let builder = builder.enable_all().thread_name(WEB).max_blocking_threads(MOST_WAITING);
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
                log.say(Level::Info, "listening", &[("address", &format!("http://{given}/"))]);
                notify("READY=1");
            };
            live::serve(wanted, site, stopped, ready).await
        });
        // A question that never returns must not hold up the end.
        runtime.shutdown_timeout(Duration::from_secs(1));
        served.map_err(|error| NotServing { address: wanted.to_string(), why: error.to_string() }.into())
    }
}

fn no_system(error: io::Error) -> ServiceFinding {
    NoSystem { why: error.to_string() }
}

/// Whether this process may do everything, which it needs not.
#[cfg(target_os = "linux")]
fn is_root() -> bool {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0)
}

#[cfg(not(target_os = "linux"))]
fn is_root() -> bool {
    false
}
