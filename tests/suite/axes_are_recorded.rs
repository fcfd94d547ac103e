//! The axes published by a controller are recorded: every packet and byte is accounted for, and an RSI controller
//! gets an
//! answer only on request.
#![cfg(unix)]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::path::Path;
use std::time::Duration;

use dbbd_device::axes::{AxesProtocol, AxesSample, rsi, rtde};
use dbbd_job::recording::axes::{AxesReceiver, AxisTrackBuilder, PacketCounts, PacketPlace};
use dbbd_job::recording::capture::{CaptureRecord, RunEvent};
use dbbd_job::sim::axes::{AxesPublisher, RECIPE};
use dbbd_job::sim::fault::InjectedFaults;
use dbbd_model::base::units::{DeviceTicks, HostNs};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::Value;

use crate::cell::{codes, dbbd, stderr};
use crate::process::{Simulator, spawn};

/// Axes of the simulated packets, which depend on the cycle.
fn axes(cycle: u64) -> [f64; 6] {
    std::array::from_fn(|axis| 1e-6 * cycle as f64 + axis as f64 * 0.1)
}

/// Faults of the line.
fn faults(seed: u64) -> InjectedFaults {
    let share = |of: u64| [0.0, 1e-4, 1e-3, 1e-2][(seed / of % 4) as usize];
    InjectedFaults {
        axes_drop: share(1),
        axes_double: share(4),
        axes_swap: share(16),
        axes_spoil: share(64),
        axes_drift_ppm: [0.0, 80.0, -250.0][(seed % 3) as usize],
        ..InjectedFaults::default()
    }
}

/// Counts of a line, and the error of the drift of the controller's clock.
struct Accounted {
    counts: PacketCounts,
    drift_off: f64,
}

/// Sends `cycles` packets over a bad line and compares every count with the faults. The controller's clock
/// drifts; the
/// packets are up to 1.5 ms late.
fn accounted(protocol: AxesProtocol, seed: u64, cycles: u64) -> Accounted {
    let cycle_s = if protocol == AxesProtocol::Rsi { 0.004 } else { 0.002 };
    let faults = faults(seed);
    let mut jitter = Pcg64::seed_from_u64(seed);
    let mut track = AxisTrackBuilder::default();
    let opened = RunEvent::AxesOpened { address: "simulated".into(), protocol };
    track.add(HostNs(0), &CaptureRecord::Event(opened));
    let mut publisher = AxesPublisher::new(protocol, &faults, seed, 4_208_163_634);
    let host_cycle_s = cycle_s / publisher.pace();
    let mut receiver = AxesReceiver::new(protocol);
    let mut control = 0;
    if protocol == AxesProtocol::Rtde {
        let recipe = [&[RECIPE], rtde::TYPES.as_bytes()].concat();
        let recipe = rtde::package(rtde::SET_UP_OUTPUTS, &recipe);
        receiver.push(HostNs(0), &recipe, |_, _, _| {});
        track.add(HostNs(0), &CaptureRecord::Axes(recipe));
        control = 1;
    }
    let mut heard = 0_u64;
    let mut take = |publisher: &mut AxesPublisher, t_s: f64| {
        while let Some(packet) = publisher.arrived(t_s) {
            let host = HostNs(((t_s + jitter.random_range(0.0..0.0015)) * 1e9) as u64 + 1);
            receiver.push(host, &packet, |place, stamp, sample| {
                heard += u64::from(matches!(place, PacketPlace::Next | PacketPlace::Late));
                assert_eq!(stamp.ticks, sample.ticks);
                let cycle = ((sample.ticks.0 - 4_208_163_634) as f64 * f64::from(protocol.tick_ns()) * 1e-9
                    / cycle_s)
                    .round() as u64;
                let sent = axes(cycle).map(f64::to_degrees);
                assert!(sample.measured_deg.iter().zip(sent).all(|(a, b)| (a - b).abs() < 6e-5));
            });
            track.add(host, &CaptureRecord::Axes(packet));
        }
    };
    // The line is good for a cycle at each end: losses there would leave no trace.
    let drifts = InjectedFaults { axes_drift_ppm: faults.axes_drift_ppm, ..InjectedFaults::default() };
    let sound = AxesPublisher::new(protocol, &drifts, seed, 4_208_163_634);
    let (mut first, mut final_one) = (sound.clone(), sound);
    first.cycle(0.0, &axes(0), &axes(0));
    take(&mut first, 0.0);
    for cycle in 1..cycles {
        let t_s = cycle as f64 * host_cycle_s;
        publisher.cycle(t_s, &axes(cycle), &axes(cycle));
        take(&mut publisher, t_s);
    }
    let end_s = cycles as f64 * host_cycle_s;
    final_one.cycle(end_s, &axes(cycles), &axes(cycles));
    take(&mut final_one, end_s);
    let (counts, sent) = (receiver.counts(), publisher.sent);
    let intact = sent.cycles - sent.dropped - sent.spoiled;
    // A packet that would be overtaken by one that never arrives is still pending.
    let under_way = (intact + 2) - heard;
    assert!(under_way <= 1, "{protocol:?} {seed}: {under_way}");
    assert_eq!(
        counts.lost,
        sent.dropped + sent.spoiled + under_way,
        "{protocol:?} {seed}: {counts:?} {sent:?}"
    );
    assert_eq!(counts.doubled, sent.doubled, "{protocol:?} {seed}: {counts:?} {sent:?}");
    assert_eq!(counts.late, sent.swapped - under_way, "{protocol:?} {seed}: {counts:?} {sent:?}");
    assert_eq!((counts.malformed, counts.control), (sent.spoiled, control));
    let parts = [counts.used, counts.late, counts.doubled, counts.stray, counts.control, counts.malformed];
    assert_eq!(counts.packets, parts.iter().sum::<u64>());
    assert_eq!((counts.stray, counts.restarts, counts.pending), (0, 0, 0));
    assert_eq!(counts.cycle_us as f64, 1e6 * cycle_s);
    let track = track.build().unwrap();
    assert_eq!(track.counts, counts);
    let clock = track.clock().unwrap();
    let drift_off = (clock.drift().unwrap() - (host_cycle_s / cycle_s - 1.0)).abs();
    // No packet is later than the jitter, so the line is within it at both ends.
    assert!(drift_off < 0.0015 / end_s, "{protocol:?} {seed}: {drift_off:e} in {end_s} s");
    Accounted { counts, drift_off }
}

#[test]
fn each_packet_of_a_bad_line_is_counted() {
    for seed in [0, 5, 85, 170, 255] {
        for protocol in [AxesProtocol::Rsi, AxesProtocol::Rtde] {
            accounted(protocol, seed, 4000);
        }
    }
}

#[test]
#[ignore = "10 million packets of each protocol over 256 bad lines; its figures go to docs/evidence/README.md"]
fn campaign_of_ten_million_packets() {
    for protocol in [AxesProtocol::Rsi, AxesProtocol::Rtde] {
        let (mut all, mut drift_off) = (PacketCounts::default(), 0.0_f64);
        for seed in 0..256 {
            let Accounted { counts, drift_off: off } = accounted(protocol, seed, 39_063);
            drift_off = drift_off.max(off);
            all.packets += counts.packets;
            all.lost += counts.lost;
            all.doubled += counts.doubled;
            all.late += counts.late;
            all.malformed += counts.malformed;
        }
        eprintln!("{protocol:?}: {all:?}, drift off by {:.3} ppm at most", 1e6 * drift_off);
        assert!(all.packets > 9_900_000);
    }
}

/// A clock that restarts, a stray packet, and bytes that are no packet.
#[test]
fn restarts_and_stray_packets_are_distinguished() {
    let packet = |ticks: u64| {
        let sample = AxesSample {
            ticks: DeviceTicks(ticks),
            measured_deg: [1.0; 6],
            commanded_deg: None,
            external: None,
            late: None,
        };
        rsi::write_datagram(&sample).into_bytes()
    };
    let mut receiver = AxesReceiver::new(AxesProtocol::Rsi);
    let mut host = 0;
    let mut push = |receiver: &mut AxesReceiver, ticks: u64| {
        host += 4_000_000;
        let mut placed = None;
        receiver.push(HostNs(host), &packet(ticks), |place, _, _| placed = Some(place));
        placed.unwrap()
    };
    for ticks in (100_000..100_400).step_by(4) {
        assert_eq!(push(&mut receiver, ticks), PacketPlace::Next);
    }
    assert_eq!(push(&mut receiver, 50_000), PacketPlace::Stray);
    assert_eq!(push(&mut receiver, 100_400), PacketPlace::Next);
    assert_eq!(push(&mut receiver, 8_000_000), PacketPlace::Stray);
    assert_eq!(push(&mut receiver, 100_404), PacketPlace::Next);
    assert_eq!(
        [8, 12, 16].map(|ticks| push(&mut receiver, ticks)),
        [PacketPlace::Stray, PacketPlace::Restart, PacketPlace::Next]
    );
    let PacketCounts { lost, stray, restarts, used, .. } = receiver.counts();
    assert_eq!((lost, stray, restarts, used), (0, 3, 1, 104));
}

/// A robot that waits for its operator, as a child process that is ready.
fn waiting(dir: &Path, more: &[&str]) -> Simulator {
    let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
               [[circle]]\nplane = \"XY\"\npoints = 3\narc_deg = 10.0\norientation = \"fixed\"\ntilt_deg = 30.0\n";
    std::fs::write(dir.join("job.toml"), job).unwrap();
    dbbd(dir, &["plan", "job.toml", "--out", "plan"]);
    assert!(dbbd(dir, &["krl", "plan/plan.csv", "--out", "krl"]).status.success());
    let fixed = ["--program", "krl/DBB_MAIN.src", "--link", "bar", "--halt", "600"];
    Simulator::start(dir, &[&fixed[..], more].concat())
}

fn free_udp() -> SocketAddr {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

/// Records for 3 s while `packets` are sent every 4 ms; returns the output, the axes of `info`, and the answers.
fn recorded(dir: &Path, query: &str, packets: &[Vec<u8>], run: &str) -> (Vec<String>, Value, Vec<String>) {
    let at = free_udp();
    let address = format!("rsi://{at}{query}");
    let acquire =
        spawn(dir, &["acquire", "--port", "bar", "--axes", &address, "--out", run, "--duration", "3"]);
    while !dir.join(run).exists() {
        std::thread::sleep(Duration::from_millis(10));
    }
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
    let (mut answers, mut room) = (Vec::new(), [0; 2048]);
    for packet in packets {
        socket.send_to(packet, at).unwrap();
        if let Ok(count) = socket.recv(&mut room) {
            answers.push(String::from_utf8(room[..count].to_vec()).unwrap());
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    while let Ok(count) = socket.recv(&mut room) {
        answers.push(String::from_utf8(room[..count].to_vec()).unwrap());
    }
    let output = acquire.wait_with_output().unwrap();
    let info = dbbd(dir, &["info", run, "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    (codes(&output), info["axes"].clone(), answers)
}

#[test]
fn rsi_is_answered_only_on_request() {
    let dir = tempfile::tempdir().unwrap();
    let _bar = waiting(dir.path(), &[]);
    let packet = |ticks: u64, late: u32| {
        let sample = AxesSample {
            ticks: DeviceTicks(ticks),
            measured_deg: [1.0, -90.5, 90.25, 0.0, -0.125, 7.0],
            commanded_deg: Some([1.0, -90.5, 90.25, 0.0, -0.125, 7.01]),
            external: None,
            late: Some(late),
        };
        rsi::write_datagram(&sample).into_bytes()
    };
    let good: Vec<Vec<u8>> = (0..100).map(|n| packet(4000 + 4 * n, 0)).collect();
    let (said, axes, answers) = recorded(dir.path(), "", &good, "quiet");
    assert!(answers.is_empty(), "{answers:?}");
    assert!(!said.iter().any(|code| code.starts_with("W22")), "{said:?}");
    let count = |axes: &Value, name: &str| axes[name].as_u64().unwrap();
    assert_eq!(["packets", "used", "lost", "cycle_us"].map(|name| count(&axes, name)), [100, 100, 0, 4000]);
    let bytes: usize = good.iter().map(Vec::len).sum();
    assert_eq!(count(&axes, "bytes"), bytes as u64);
    let exported = dbbd(dir.path(), &["export", "quiet", "--out", "csv"]);
    assert_eq!(exported.status.code(), Some(0), "{}", stderr(&exported));
    let table = std::fs::read_to_string(dir.path().join("csv/axes.csv")).unwrap();
    assert_eq!(table.lines().count(), 101);
    assert!(
        table
            .lines()
            .nth(1)
            .unwrap()
            .ends_with(",4000,next,1,-90.5,90.25,0,-0.125,7,1,-90.5,90.25,0,-0.125,7.01")
    );
    let mcap = dbbd(dir.path(), &["export", "quiet", "--out", "mcap", "--mcap", "--json"]);
    let mcap: Value = serde_json::from_slice(&mcap.stdout).unwrap();
    assert_eq!(mcap["axes"], 100);

    // Every fourth is missing, one is no text, the clock restarts, and answers are late.
    let mut bad: Vec<Vec<u8>> = (0..100).filter(|n| n % 4 != 1).map(|n| packet(4000 + 4 * n, 2)).collect();
    bad.insert(10, vec![0xff, 0xfe]);
    bad.insert(20, b"<Rob><AIPos A1=\"1\"/><IPOC>12</IPOC></Rob>".to_vec());
    bad.extend((0..20).map(|n| packet(100 + 4 * n, 3)));
    let (said, axes, answers) = recorded(dir.path(), "?answer=zero", &bad, "answered");
    for code in ["W2211", "W2212", "W2213"] {
        assert!(said.iter().any(|found| found == code), "{code}: {said:?}");
    }
    assert_eq!(["lost", "malformed", "stray", "restarts"].map(|name| count(&axes, name)), [25, 2, 1, 1]);
    assert_eq!(axes["faults"]["not_xml"], 1);
    assert_eq!(axes["faults"]["incomplete"], 1);
    // Each packet with a time is answered once, with this time.
    assert_eq!(answers.len(), 95, "{answers:?}");
    for (answer, n) in answers.iter().zip((0..100).filter(|n| n % 4 != 1)) {
        let zeros: String = (1..=6).map(|axis| format!(" A{axis}=\"0.0000\"")).collect();
        let ipoc = 4000 + 4 * n;
        assert_eq!(*answer, format!("<Sen Type=\"ImFree\"><AK{zeros}/><IPOC>{ipoc}</IPOC></Sen>"));
    }

    let (said, ..) = recorded(dir.path(), "", &[], "silent");
    assert!(said.iter().any(|code| code == "W2210"), "{said:?}");
}

#[test]
fn unusable_addresses_are_refused_with_a_code() {
    let dir = tempfile::tempdir().unwrap();
    let acquire = |axes: &str| {
        let output = dbbd(dir.path(), &["acquire", "--port", "none", "--axes", axes, "--out", "run"]);
        (output.status.code(), stderr(&output))
    };
    for text in ["rsi://nowhere", "udp://0.0.0.0:1", "rsi://0.0.0.0:1?answer=all", "rtde://h?hz=0", "rtde://"]
    {
        let (code, said) = acquire(text);
        assert_eq!(code, Some(2), "{text}: {said}");
        let wrong = text.parse::<dbbd_device::axes::AxesAddress>().unwrap_err();
        assert_eq!(dbbd_model::diagnostic::Finding::code(&wrong).as_str(), "E2201", "{text}");
    }
    for text in ["rsi://0.0.0.0:49152", "rsi://[::1]:5?answer=zero", "rtde://10.0.0.1:30004?hz=250"] {
        assert_eq!(text.parse::<dbbd_device::axes::AxesAddress>().unwrap().to_string(), text);
    }
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let (code, said) = acquire(&format!("rsi://{}", taken.local_addr().unwrap()));
    assert!(code == Some(1) && said.contains("E2202"), "{said}");
    let gone = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let (code, said) = acquire(&format!("rtde://{gone}"));
    assert!(code == Some(1) && said.contains("E2203"), "{said}");
    // A controller without a variable.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let controller = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut room = [0; 512];
        for answer in [
            rtde::package(rtde::ASK_VERSION, &[1]),
            rtde::package(rtde::SET_UP_OUTPUTS, b"\x01DOUBLE,NOT_FOUND,VECTOR6D"),
        ] {
            let _ = stream.read(&mut room).unwrap();
            stream.write_all(&answer).unwrap();
        }
        let _ = stream.read(&mut room);
    });
    let (code, said) = acquire(&format!("rtde://{address}"));
    assert!(code == Some(1) && said.contains("E2204"), "{said}");
    controller.join().unwrap();
}

/// The whole chain in real time: a simulated controller drives and publishes its axes, the poses are matched by
/// them, and
/// the lengths are taken at the measured axes.
#[test]
fn simulated_controller_is_recorded_matched_and_identified() {
    let dir = tempfile::tempdir().unwrap();
    let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
               [[circle]]\nplane = \"XY\"\npoints = 3\narc_deg = 10.0\norientation = \"fixed\"\ntilt_deg = 30.0\n[motion]\n\
               settle_s = 0.2\ndwell_s = 0.4\n";
    std::fs::write(dir.path().join("job.toml"), job).unwrap();
    std::fs::write(dir.path().join("world.toml"), "following_ms = [20, 22, 18, 12, 14, 10]\n").unwrap();
    dbbd(dir.path(), &["plan", "job.toml", "--out", "plan"]);
    assert!(dbbd(dir.path(), &["krl", "plan/plan.csv", "--out", "krl"]).status.success());
    let at = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let address = format!("rtde://{at}");
    let fixed = ["--program", "krl/DBB_MAIN.src", "--world", "world.toml", "--link", "bar", "--halt", "0.5"];
    let _bar = Simulator::start(dir.path(), &[&fixed[..], &["--axes", &address]].concat());
    let axes = format!("{address}?hz=250");
    let acquire = ["acquire", "--port", "bar", "--plan", "plan/plan.csv", "--out", "run", "--duration", "60"];
    let recorded = dbbd(dir.path(), &[&acquire[..], &["--axes", &axes]].concat());
    assert!(matches!(recorded.status.code(), Some(0 | 3)), "{}", stderr(&recorded));
    let synced = dbbd(dir.path(), &["sync", "run", "--out", "obs.csv", "--json"]);
    let json: Value = serde_json::from_slice(&synced.stdout).unwrap();
    assert_eq!(json["source"], "the published axes", "{json}");
    assert_eq!(json["matched"].as_u64().unwrap(), json["poses"].as_array().unwrap().len() as u64, "{json}");
    assert_eq!(json["axes"]["measured"], json["matched"]);
    assert_eq!(json["axes"]["packets"]["cycle_us"], 4000);
    assert!(codes(&synced).contains(&"I2221".to_owned()), "{}", stderr(&synced));
    let found = dbbd(dir.path(), &["identify", "run", "--out", "found", "--prior", "datasheet", "--json"]);
    let result: Value = serde_json::from_slice(&found.stdout).unwrap();
    let says = |warning: &Value| warning["code"] == "I2221";
    assert!(result["findings"].as_array().unwrap().iter().any(says), "{}", stderr(&found));
}

/// A client that shares no code with dbbd reads what dbbd records.
#[test]
#[ignore = "needs ur-rtde of Python: .ci/night"]
#[cfg(target_os = "linux")]
fn ur_rtde_reads_the_simulated_controller() {
    use crate::cell::client;
    let dir = tempfile::tempdir().unwrap();
    // It supports the standard port only, so the address is another.
    let host = format!("127.0.{}.{}", std::process::id() / 250 % 250, 1 + std::process::id() % 250);
    let address = format!("rtde://{host}:30004");
    let _robot = waiting(dir.path(), &["--axes", &address]);
    // The time of the simulated robot continues while its bar is read.
    let mut reader = spawn(dir.path(), &["acquire", "--port", "bar", "--out", "first", "--duration", "60"]);
    // After 6 s it waits for its operator.
    let said = client("axes.py", ["ur-rtde", &host, "9"].map(std::ffi::OsStr::new).into_iter());
    reader.kill().unwrap();
    reader.wait().unwrap();
    eprintln!("{said}");
    let theirs: Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();
    assert!(theirs["times"].as_u64().unwrap() > 50, "{theirs}");
    let cycles = |step: &String| (step.parse::<f64>().unwrap() / 4.0).fract();
    assert!(theirs["steps_ms"].as_object().unwrap().keys().all(|step| cycles(step) == 0.0), "{theirs}");
    let acquire = ["acquire", "--port", "bar", "--out", "run", "--duration", "2", "--axes", &address];
    dbbd(dir.path(), &acquire);
    assert!(dbbd(dir.path(), &["export", "run", "--out", "csv"]).status.success());
    let table = std::fs::read_to_string(dir.path().join("csv/axes.csv")).unwrap();
    let columns: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    let row: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
    for (name, first) in [("measured_deg", columns.len() - 12), ("commanded_deg", columns.len() - 6)] {
        for (axis, ours) in row[first..first + 6].iter().enumerate() {
            let off = theirs[name][axis].as_f64().unwrap() - ours.parse::<f64>().unwrap();
            assert!(off.abs() < 1e-9, "{name} {axis}: {off}");
        }
    }
}
