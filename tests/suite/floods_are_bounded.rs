//! A line that sends as fast as it can takes neither the memory of the recorder nor one byte of the account.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::Write;
use std::net::TcpListener;

use dbbd_device::clock;
use dbbd_device::protocol::LineFault;
use dbbd_job::recording::capture::{CaptureRecord, CaptureSummary};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

use crate::cell::stderr;
use crate::played_bar::definition;
use crate::process::dbbd;

/// Peak of a process that records a flood, kB. One that is idle takes about 15 MB, a full channel to the recorder 16 MB.
const MAX_PEAK_KB: u64 = 64 * 1024;

/// A frame of dbb-cobs-1: 14 bytes, 2 of the CRC, 2 of COBS.
const FRAME_BYTES: u64 = 18;

/// Records this endless stream for a while; returns the peak of the memory, kB.
fn flooded(name: &str, pattern: Vec<u8>) -> u64 {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp://{}", server.local_addr().unwrap());
    let mut child =
        dbbd(&["acquire", "--quiet", "--port", &port, "--out", out.to_str().unwrap(), "--duration", "3"])
            .spawn()
            .unwrap();
    let (mut line, _) = server.accept().unwrap();
    // It fails when the recorder closes the line.
    let flood = std::thread::spawn(move || while line.write_all(&pattern).is_ok() {});
    let mut peak_kb = 0;
    while child.try_wait().unwrap().is_none() {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        peak_kb = peak.map_or(peak_kb, |kb| kb.trim().trim_end_matches(" kB").parse().unwrap());
        clock::sleep(0.01);
    }
    flood.join().unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(matches!(output.status.code(), Some(0 | 3)), "{name}: {}", stderr(&output));
    let (mut raw, mut accounted, mut events, mut gaps) = (0, 0, 0, 0);
    let summary = CaptureSummary::over(&out, |stamped| {
        match stamped.record {
            CaptureRecord::Raw(bytes) => raw += bytes.len() as u64,
            CaptureRecord::Samples(samples) => accounted += samples.len() as u64 * FRAME_BYTES,
            CaptureRecord::Fault(json) => {
                accounted += serde_json::from_slice::<LineFault>(&json).unwrap().bytes
            }
            CaptureRecord::Event(event) => (events, gaps) = (events + 1, gaps + event.gaps().0),
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    assert!(summary.damages.is_empty() && summary.end.is_some(), "{name}");
    assert!(raw > 1 << 20, "{name}: {raw} bytes");
    assert_eq!(raw, accounted, "{name}");
    // 200 a second, those at begin and end, and one a second of what was withheld.
    assert!(events < 1000, "{name}: {events} events");
    assert!(
        gaps + 1 >= summary.samples,
        "{name}: the same number in each sample: {gaps} of {}",
        summary.samples
    );
    peak_kb
}

#[test]
fn floods_take_no_memory_and_each_byte_is_accounted_for() {
    let definition = definition();
    let mut frame = Vec::new();
    let sample = Sample {
        sequence: Some(7),
        ticks: Some(DeviceTicks(1)),
        trigger: Some(false),
        temperature_c: Some(20.0),
        ..Sample::of(0.1)
    };
    definition.encoder().encode(&sample, &mut frame).unwrap();
    let floods = [
        ("zeros", vec![0]),
        ("ones", vec![0xff]),
        ("frames", frame),
        // With which the records of a capture begin.
        ("magic", vec![0xdb, 0xbd, 0x5a, 0xa5]),
    ];
    std::thread::scope(|scope| {
        let floods = floods.map(|(name, unit)| {
            (name, scope.spawn(move || flooded(name, unit.repeat((1 << 16) / unit.len()))))
        });
        for (name, peak_kb) in floods {
            let peak_kb = peak_kb.join().unwrap();
            assert!(peak_kb < MAX_PEAK_KB, "{name}: {peak_kb} kB");
        }
    });
}
