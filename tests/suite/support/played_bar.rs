//! A virtual bar in this process, on a pseudo-terminal that `dbbd acquire` reads, and the resulting capture.
#![cfg(unix)]

use std::path::Path;
use std::thread::JoinHandle;

use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::{self, Capture};
use dbbd_job::sim::bar::{self, ReadingSource, SimulatedReading, Terminal, VirtualBarOptions};
use dbbd_model::measurement::sample::Sample;

pub(crate) const RATE_HZ: f64 = 1000.0;

pub(crate) fn definition() -> ProtocolDefinition {
    ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap()
}

/// Readings on the 10 nm grid of the protocol, one per millisecond.
pub(crate) fn reading_mm(frame: u64) -> f64 {
    (f64::from(u32::try_from(frame % 20_001).unwrap()) - 10_000.0) / 1e5
}

pub(crate) fn reading(t_s: f64, strobe: bool) -> SimulatedReading {
    let frame = (t_s * RATE_HZ).round() as u64;
    SimulatedReading { reading_mm: reading_mm(frame), strobe, valid: true, temperature_c: 20.0 }
}

/// Plays a source on a new terminal; returns its name, and the thread that gives the number of frames sent.
pub(crate) fn play(speed: f64, source: impl ReadingSource + Send + 'static) -> (String, JoinHandle<u64>) {
    let terminal = Terminal::new().unwrap();
    let name = terminal.address().to_string();
    // The counter wraps after two seconds.
    let options = VirtualBarOptions { rate_hz: RATE_HZ, speed, first_ticks: (1 << 32) - 2_000_000 };
    (name, std::thread::spawn(move || bar::serve_bar(terminal, &definition(), options, source).unwrap()))
}

pub(crate) fn endless() -> impl ReadingSource {
    |t: f64| (t < 1e6).then(|| reading(t, false))
}

/// Waits until the capture holds this number of bytes.
pub(crate) fn wait_for(path: &Path, bytes: u64) {
    for _ in 0..500 {
        if std::fs::metadata(path).is_ok_and(|data| data.len() >= bytes) {
            return;
        }
        clock::sleep(0.02);
    }
    panic!("{} does not grow", path.display());
}

pub(crate) fn read(path: &Path) -> Capture {
    capture::read_capture(&std::fs::read(path).unwrap())
}

pub(crate) fn samples(capture: &Capture) -> Vec<Sample> {
    capture.samples().map(|(_, sample)| *sample).collect()
}
