//! The service from its first word to its last: runtime, signals, sign of life.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::watch;

use super::config::Config;
use super::log::{Level, Log};
use super::notify::{notify, watchdog_s};
use super::state::Supervisor;
use super::trial_cell::Bench;
use crate::base::clock;
use crate::catalogue::ServiceFinding::{self, NoSystem, NotServing, WorkerLost};
use crate::daemon::signals;
use crate::diagnostic::Diagnostic;
use crate::live::{self, Access, Service};

/// How often the state is looked at, s.
const LOOK_S: f64 = 0.2;
/// The pages' thread counts as alive when it moved within so many seconds.
const ALIVE_S: f64 = 5.0;

/// Questions of clients that wait for disk or device at a time.
const MOST_WAITING: usize = 16;

/// Serves until SIGINT or SIGTERM; a run that is on then ends as it should. `bench` makes the cell of the
/// port `sim`.
///
/// # Errors
/// When the address cannot be had or the system gives no threads.
pub fn serve(mut config: Config, log: Arc<dyn Log>, bench: Option<Bench>) -> Result<(), Diagnostic> {
    let address = config.address;
    let access = Access::new(address.ip(), &config.hosts, config.token.take());
    if !address.ip().is_loopback() {
        let fields: [(&str, &dyn std::fmt::Display); 1] = [("address", &address)];
        log.say(Level::Warning, "open_to_the_network_without_encryption", &fields);
    }
    if is_root() {
        log.say(Level::Warning, "running_as_root", &[("help", &"docs/how-to/service.md")]);
    }
    let supervisor = Arc::new(Supervisor::new(config, Arc::clone(&log), bench).map_err(no_system)?);
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_all().max_blocking_threads(MOST_WAITING).build().map_err(no_system)?;
    let (stop, stopped) = watch::channel(false);
    let beat = Arc::new(AtomicU64::new(clock::now().0));
    let over = Arc::new(AtomicBool::new(false));
    let watcher = {
        let (supervisor, beat, over) = (Arc::clone(&supervisor), Arc::clone(&beat), Arc::clone(&over));
        std::thread::Builder::new()
            .name("supervisor".into())
            .spawn(move || look(&supervisor, &beat, &over))
            .map_err(no_system)?
    };
    let service: Arc<dyn Service> = supervisor.clone();
    let served = runtime.block_on(async {
        let mut signals = signals::Signals::new().map_err(no_system)?;
        tokio::spawn(async move {
            loop {
                beat.store(clock::now().0, Ordering::Relaxed);
                tokio::time::sleep(Duration::from_secs(1)).await;
            }
        });
        tokio::spawn(async move {
            signals.wait().await;
            stop.send_replace(true);
        });
        let ready = |address: SocketAddr| {
            log.say(Level::Info, "listening", &[("address", &format!("http://{address}/"))]);
            notify("READY=1");
        };
        let served = live::serve(address, service, access, stopped, ready).await;
        served.map_err(|error| NotServing { address: address.to_string(), why: error.to_string() })
    });
    notify("STOPPING=1");
    supervisor.end();
    // A question that never returns must not hold up the end.
    runtime.shutdown_timeout(Duration::from_secs(1));
    over.store(true, Ordering::Relaxed);
    let watched = watcher.join();
    served?;
    watched.map_err(|_| WorkerLost { worker: "supervisor".into() })?;
    log.say(Level::Info, "stopped", &[]);
    Ok(())
}

/// Keeps the state up to date and notifies the service manager.
fn look(supervisor: &Supervisor, beat: &AtomicU64, over: &AtomicBool) {
    let mut notified = None;
    let (pause_s, mut signed) = (watchdog_s(), clock::now());
    while !over.load(Ordering::Relaxed) {
        let state = supervisor.tick();
        if notified.replace(state) != Some(state) {
            notify(&format!("STATUS={}", state.name()));
        }
        let now = clock::now();
        let alive = now.seconds_since(crate::base::units::HostNs(beat.load(Ordering::Relaxed))) < ALIVE_S;
        if pause_s.is_some_and(|pause_s| now.seconds_since(signed) >= pause_s) && alive {
            notify("WATCHDOG=1");
            signed = now;
        }
        clock::sleep(LOOK_S);
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
