//! First contact with a bar: `bar identify` identifies its protocol or reports that it is unknown; `bar check` measures its noise.

use std::path::Path;
use std::process::Output;
use std::thread;

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::sim::bar::{self, ReadingSource, SimulatedReading, Terminal, VirtualBarOptions};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;
use serde_json::Value;

use crate::cell::codes;
use crate::process::run;
use crate::support::spoken::assert_spoken;

const UNKNOWN: &str = "W2100";
const SILENT: &str = "W2102";
const FEW: &str = "E2105";
const NOT_AT_REST: &str = "W2106";
const DRIFTS: &str = "W2107";
const RATE: &str = "W2108";
const INVALID: &str = "W2109";

fn built_in() -> Vec<ProtocolDefinition> {
    ProtocolDefinition::built_in()
        .iter()
        .map(|(name, _)| ProtocolDefinition::by_name(name).unwrap().unwrap())
        .collect()
}

const GPS: &str = "$GPGGA,123519.00,4807.0380,N,01131.0000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n\
                   $GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1*39\r\n\
                   $GPRMC,123519.00,A,4807.0380,N,01131.0000,E,022.4,084.4,230394,003.1,W*6A\r\n";

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)))
}

/// A virtual bar; its port.
fn served(
    definition: &ProtocolDefinition,
    rate_hz: f64,
    source: impl ReadingSource + Send + 'static,
) -> String {
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    let definition = definition.clone();
    let options = VirtualBarOptions { rate_hz, speed: 1.0, first_ticks: 0 };
    thread::spawn(move || bar::serve_bar(terminal, &definition, options, source));
    port
}

fn at_rest(reading_mm: f64) -> Option<SimulatedReading> {
    Some(SimulatedReading { reading_mm, strobe: false, valid: true, temperature_c: 20.0 })
}

#[test]
fn each_virtual_bar_is_identified_over_its_line() {
    thread::scope(|scope| {
        for definition in built_in() {
            scope.spawn(move || {
                let port = served(&definition, 100.0, |t_s: f64| at_rest(0.01 * t_s.sin()));
                let identify = || run(&["bar", "identify", "--port", &port, "--json"]);
                // On a busy machine a simulated bar may answer after its time.
                let first = identify();
                let output = if json(&first)["protocol"].is_null() { identify() } else { first };
                let said = json(&output);
                assert_eq!(said["protocol"], *definition.id, "{said}");
                assert_eq!(output.status.code(), Some(0));
            });
        }
    });
}

#[test]
fn unidentified_bytes_are_reported() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        for (mut client, says) in listener.incoming().flatten().zip([GPS, ""]) {
            thread::spawn(move || {
                use std::io::Write;
                while client.write_all(says.as_bytes()).is_ok() {
                    dbbd_device::clock::sleep(0.1);
                }
            });
        }
    });
    for code in [UNKNOWN, SILENT] {
        let output = run(&["bar", "identify", "--port", &port, "--listen", "--json"]);
        assert_eq!((codes(&output), output.status.code()), (vec![code.to_owned()], Some(3)));
        assert_eq!(json(&output)["protocol"], Value::Null);
    }
}

fn check(directory: &Path, port: &str, protocol: &str, seconds: &str) -> Output {
    let out = directory.join("check");
    run(&[
        "bar",
        "check",
        "--port",
        port,
        "--protocol",
        protocol,
        "--duration",
        seconds,
        "--json",
        "--out",
        out.to_str().unwrap(),
    ])
}

/// A bar at 1000 Hz with 0.5 um of noise, in steps of 0.01 um.
fn noisy(also: impl Fn(f64) -> f64 + Send + 'static) -> impl ReadingSource + Send + 'static {
    let mut dice = Pcg64::seed_from_u64(5);
    let noise = Normal::new(0.0, 0.0005).unwrap();
    move |t_s: f64| at_rest(0.2 + also(t_s) + noise.sample(&mut dice))
}

/// White noise s at n readings a second leaves s / sqrt(n) in a mean of one second; the limits are four standard
/// deviations of the estimates from 8 s: 1 / sqrt(2 n) of a standard deviation from n values.
#[test]
fn bar_check_measures_noise_resolution_and_rate() {
    let directory = tempfile::tempdir().unwrap();
    let definition = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
    let port = served(&definition, 1000.0, noisy(|_| 0.0));
    let output = check(directory.path(), &port, "dbb-cobs-1", "9");
    let found = json(&output);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let number = |name: &str| found[name].as_f64().unwrap();
    assert!((number("noise_mm") / 0.0005 - 1.0).abs() < 0.04, "{found}");
    assert!((number("resolution_mm") - 1e-5).abs() < 1e-9);
    assert!((number("rate_hz") - 1000.0).abs() < 1.0);
    assert!((number("sigma_mm") / (0.0005 / 1000f64.sqrt()) - 1.0).abs() < 4.0 / 12f64.sqrt());
    assert!(number("drift_mm_min").abs() < 4.0 * number("drift_sd_mm_min"));
    let toml: toml::Table =
        std::fs::read_to_string(directory.path().join("check/bar.toml")).unwrap().parse().unwrap();
    let sigma_um = toml["bar"]["sigma_um"].as_float().unwrap();
    assert!((sigma_um - 1e3 * number("sigma_mm")).abs() < 0.000_51, "{toml}");
    assert_eq!(toml["bar"]["protocol"].as_str(), Some("dbb-cobs-1"));
    for file in ["bar.html", "bar.json", "bar.dbbd"] {
        assert!(directory.path().join("check").join(file).exists());
    }
    assert_spoken(&std::fs::read_to_string(directory.path().join("check/bar.html")).unwrap());
}

#[test]
fn bar_check_reports_faults_of_the_bar() {
    let cobs = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
    let cases: Vec<(&str, String, Vec<&str>)> = vec![
        (
            "jump",
            served(&cobs, 1000.0, noisy(|t_s| if t_s > 4.0 && t_s < 5.2 { 0.01 } else { 0.0 })),
            vec![NOT_AT_REST],
        ),
        // 6 um a minute.
        ("drift", served(&cobs, 1000.0, noisy(|t_s| 1e-4 * t_s)), vec![DRIFTS]),
        ("slow", served(&cobs, 200.0, noisy(|_| 0.0)), vec![RATE]),
        (
            "has_warnings",
            served(&cobs, 1000.0, |t_s: f64| {
                at_rest(0.1).map(|at| SimulatedReading { valid: t_s % 1.0 < 0.5, ..at })
            }),
            vec![INVALID],
        ),
        ("short", served(&cobs, 1000.0, |t_s: f64| at_rest(0.1).filter(|_| t_s < 1.0)), vec![FEW]),
    ];
    thread::scope(|scope| {
        for (name, port, expected) in cases {
            scope.spawn(move || {
                let directory = tempfile::tempdir().unwrap();
                let output = check(directory.path(), &port, "dbb-cobs-1", "9");
                let said = codes(&output);
                assert!(expected.iter().all(|code| said.contains(&(*code).to_owned())), "{name}: {said:?}");
            });
        }
    });
}
