//! Bars behind serial servers: raw TCP and RFC 2217, of the simulator, of ser2net and of pyserial.
#![cfg(unix)]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;

use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

use crate::cell::{codes, stderr};
use crate::process::dbbd;
use crate::virtual_bar::{Run, acquire, simulate};

const WRONG_ADDRESS: &str = "E0230";
const AWAY: &str = "E0231";
const CLOSES: &str = "E0232";
const NOT_RFC2217: &str = "E0233";
const SETTING: &str = "E0234";
const BLURS: &str = "I0240";

/// The program ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A server that does this with its clients; returns its port.
fn server(with: impl Fn(TcpStream) + Send + 'static) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || listener.incoming().flatten().for_each(with));
    port
}

/// The code with which `acquire` refuses a port, and its exit code.
fn refusal(directory: &Path, port: &str) -> (Vec<String>, Option<i32>) {
    let mut command = dbbd(&["acquire", "--port", port, "--out", "refused", "--duration", "1"]);
    let output = command.current_dir(directory).output().unwrap();
    assert!(!directory.join("refused").exists(), "{port}");
    (codes(&output), output.status.code())
}

#[test]
fn unusable_server_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    let at = directory.path();
    assert_eq!(refusal(at, "tcp://127.0.0.1"), (vec![WRONG_ADDRESS.into()], Some(2)));
    let with_note = |code: &str| (vec![BLURS.to_owned(), code.to_owned()], Some(1));
    assert_eq!(refusal(at, &format!("tcp://127.0.0.1:{}", free_port())), with_note(AWAY));
    let taken = server(|mut client| client.write_all(b"Port already in use\r\n").unwrap());
    assert_eq!(refusal(at, &format!("tcp://127.0.0.1:{taken}")), with_note(CLOSES));
    // IAC DONT COM-PORT-OPTION.
    let raw = server(|mut client| {
        client.write_all(&[255, 254, 44]).unwrap();
        let _ = client.read_to_end(&mut Vec::new());
    });
    assert_eq!(refusal(at, &format!("rfc2217://127.0.0.1:{raw}")), with_note(NOT_RFC2217));
    // IAC DO COM-PORT-OPTION; the rate stays at 9600 baud whatever is requested.
    let fixed = server(|mut client| {
        client.write_all(&[255, 253, 44, 255, 250, 44, 101, 0, 0, 0x25, 0x80, 255, 240]).unwrap();
        let _ = client.read_to_end(&mut Vec::new());
    });
    assert_eq!(refusal(at, &format!("rfc2217://127.0.0.1:{fixed}")), with_note(SETTING));
}

/// Readings without a loss, and every byte in a sample or a fault.
fn is_whole(run: &Run, transport: &str) {
    assert_eq!(run.output.status.code(), Some(0), "{}", stderr(&run.output));
    assert!(run.rows.len() > 200, "{} samples", run.rows.len());
    for pair in run.rows.windows(2) {
        let [before, after] = [&pair[0], &pair[1]].map(|row| row.sample.sequence.unwrap());
        assert_eq!((before + 1) % 65536, after);
    }
    let in_faults: u64 = run.faults.iter().map(|(_, _, bytes)| bytes).sum();
    assert_eq!(run.bytes, 18 * run.rows.len() as u64 + in_faults);
    let opened = run.events.iter().find(|(_, name, _)| name == "opened").unwrap();
    assert_eq!(opened.2["stamps"]["transport"], transport);
    assert!(opened.2["stamps"]["held_ms"].as_f64().unwrap() >= 0.0);
}

#[test]
fn the_simulator_serves_each_transport() {
    for transport in ["tcp", "rfc2217"] {
        let directory = tempfile::tempdir().unwrap();
        let bar = simulate(directory.path(), "1", &["--listen", &format!("{transport}://127.0.0.1:0")]);
        assert!(bar.port.starts_with(transport), "{}", bar.port);
        let port = bar.port.clone();
        let at = directory.path().to_owned();
        let first = thread::spawn(move || acquire(&at, &port, "2", &[]));
        clock::sleep(1.0);
        // Only one client may use the line.
        let second = refusal(directory.path(), &bar.port);
        assert_eq!(second, (vec![BLURS.into(), CLOSES.into()], Some(1)));
        let run = first.join().unwrap();
        is_whole(&run, transport);
        assert_eq!(codes(&run.output), [BLURS]);
    }
}

/// ser2net without RFC 2217: it greets with telnet, and doubles each 255 of the bar; negative lengths have many.
#[test]
fn plain_telnet_is_spoken_where_the_server_begins_it() {
    let encoder = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap().encoder();
    let port = server(move |mut client| {
        client.write_all(&[255, 251, 3, 255, 251, 0, 255, 253, 0]).unwrap();
        for sequence in 0..65536u32 {
            let reading_mm = if sequence % 3 == 0 { 0.25 } else { -0.12345 };
            let (sequence, ticks) = (Some(sequence), Some(DeviceTicks(5000 * u64::from(sequence))));
            let sample = Sample {
                sequence,
                ticks,
                trigger: Some(false),
                temperature_c: Some(21.5),
                status: 1,
                ..Sample::of(reading_mm)
            };
            let mut frame = Vec::new();
            encoder.encode(&sample, &mut frame).unwrap();
            let doubled =
                frame.iter().flat_map(|&byte| std::iter::repeat_n(byte, if byte == 255 { 2 } else { 1 }));
            if client.write_all(&doubled.collect::<Vec<u8>>()).is_err() {
                return;
            }
            clock::sleep(0.001);
        }
    });
    let directory = tempfile::tempdir().unwrap();
    let run = acquire(directory.path(), &format!("tcp://127.0.0.1:{port}"), "2", &[]);
    is_whole(&run, "tcp");
    assert_eq!(codes(&run.output), [BLURS, "I0241"]);
    assert!(run.faults.iter().all(|(_, kind, _)| kind != "check"), "{:?}", run.faults);
}

/// The key mm/inch of a gauge: 0.12345 inches are not 0.12345 mm.
#[test]
fn readings_in_another_unit_are_refused() {
    for (unit, expected) in [("mm", [0.123, 3.136]), ("inch", [3.13563, 3.135884])] {
        let port = server(|mut client| {
            for reading in ["01A+0000.123\r", "01A+0003.136\r", "01A+00.12345\r", "01A+00.12346\r"] {
                clock::sleep(0.3);
                if client.write_all(reading.as_bytes()).is_err() {
                    return;
                }
            }
            clock::sleep(5.0);
        });
        let address = format!("tcp://127.0.0.1:{port}");
        let directory = tempfile::tempdir().unwrap();
        let unit = format!("unit={unit}");
        let run =
            acquire(directory.path(), &address, "2", &["--protocol", "mitutoyo-push", "--param", &unit]);
        let lengths: Vec<f64> = run.rows.iter().map(|row| row.sample.reading_mm).collect();
        assert!(lengths.len() == 2, "{unit}: {lengths:?} {}", stderr(&run.output));
        assert!(
            lengths.iter().zip(expected).all(|(mm, expected)| (mm - expected).abs() < 1e-9),
            "{lengths:?}"
        );
        assert!(codes(&run.output).contains(&"W0228".to_owned()), "{}", stderr(&run.output));
        assert_eq!(run.output.status.code(), Some(3));
    }
}

#[test]
#[ignore = "needs pyserial: .ci/night"]
fn pyserial_server_works() {
    let directory = tempfile::tempdir().unwrap();
    let bar = simulate(directory.path(), "1", &[]);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/clients/rfc2217_server.py");
    let mut child = Command::new("python3").args([script, &bar.port]).stdout(Stdio::piped()).spawn().unwrap();
    let mut port = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut port).unwrap();
    let _server = Running(child);
    let address = format!("rfc2217://127.0.0.1:{}", port.trim());
    // The server takes a second client after the first.
    for _ in 0..2 {
        let place = tempfile::tempdir().unwrap();
        is_whole(&acquire(place.path(), &address, "1.5", &[]), "rfc2217");
    }
}

#[test]
#[ignore = "needs ser2net: .ci/night"]
fn ser2net_server_works() {
    for (scheme, accepter) in [("tcp", "tcp"), ("tcp", "telnet,tcp"), ("rfc2217", "telnet(rfc2217),tcp")] {
        let directory = tempfile::tempdir().unwrap();
        let bar = simulate(directory.path(), "1", &[]);
        let port = free_port();
        let config = format!(
            "connection: &bar\n  accepter: {accepter},127.0.0.1,{port}\n  connector: serialdev,{},115200n81,local\n",
            bar.port
        );
        let file = directory.path().join("ser2net.yaml");
        std::fs::write(&file, config).unwrap();
        let _server = Running(Command::new("ser2net").args(["-n", "-c"]).arg(&file).spawn().unwrap());
        clock::sleep(1.0);
        let address = format!("{scheme}://127.0.0.1:{port}");
        let run = acquire(directory.path(), &address, "2", &[]);
        is_whole(&run, scheme);
    }
}
