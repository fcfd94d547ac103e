//! Whether readings are measured or simulated is a property of the data: it goes from the stream into the capture, the table, the
//! result, the robot file, the check and the corrected program.

use std::fs;
use std::io::Write as _;
use std::net::TcpListener;
use std::path::Path;
use std::thread;

use serde_json::Value;
use tempfile::tempdir;

use crate::cell::{codes, dbbd, stderr};
use crate::virtual_bar::simulate;

fn done(at: &Path, args: &str) -> Vec<String> {
    let output = dbbd(at, &args.split_whitespace().collect::<Vec<_>>());
    assert!(matches!(output.status.code(), Some(0 | 3)), "{args}: {}", stderr(&output));
    codes(&output)
}

fn origin(at: &Path, capture: &str) -> Value {
    let output = dbbd(at, &["info", capture, "--json"]);
    serde_json::from_slice::<Value>(&output.stdout).unwrap()["origin"].clone()
}

/// The demo, its check, its certificate and a corrected program.
#[test]
fn simulated_readings_are_stated_wherever_they_lead() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    assert!(done(at, "demo --circles --out . --quiet").iter().all(|code| code != "W1851"));
    assert_eq!(origin(at, "run.dbbd"), "simulated");
    for file in ["observations.provenance.json", "result/result.json", "result/robot-identified.toml"] {
        assert!(fs::read_to_string(at.join(file)).unwrap().contains("simulated"), "{file}");
    }
    let report = fs::read_to_string(at.join("result/report.html")).unwrap();
    assert!(report.contains("<p class=\"simulated\""));
    // A certificate is refused, a specimen is none.
    let refused = dbbd(at, &["certificate", "result", "--out", "certificate"]);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E2008".into()]));
    assert!(!at.join("certificate").exists());
    done(at, "certificate result --specimen --out certificate");
    let [html, dcc] = ["certificate.html", "dcc.xml"]
        .map(|file| fs::read_to_string(at.join("certificate").join(file)).unwrap());
    // In the head of each printed page, over it, and where it would be signed.
    assert!(html.matches("SPECIMEN").count() >= 4 && html.contains("A specimen states no traceability"));
    assert!(!html.contains("traceable to the SI") && !html.contains("class=\"signatures\""));
    assert!(dcc.contains("<dcc:uniqueIdentifier>specimen</") && dcc.contains("<dcc:traceable>false</"));
    // A corrected program has it in its chain.
    let source = "DEF P()\n$TOOL={X 30,Y 20,Z 10,A 0,B 0,C 0}\n$BASE=$NULLFRAME\nPTP XP1\nEND\n";
    let data = "DEFDAT P\nDECL E6POS XP1={X 1300.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0,S 2,T 10}\nENDDAT\n";
    fs::write(at.join("P.src"), source).unwrap();
    fs::write(at.join("P.dat"), data).unwrap();
    assert!(
        done(at, "compensate P.src --robot result/robot-identified.toml --out new").contains(&"I1850".into())
    );
    assert!(fs::read_to_string(at.join("new/P.src")).unwrap().contains("\"origin\":\"simulated\""));
    // A robot that was identified from a table of which nothing is known may be a real one.
    fs::copy(at.join("observations.csv"), at.join("typed.csv")).unwrap();
    done(
        at,
        "identify typed.csv --robot kr60ha --tool 30,20,10 --centres plan/centres.csv --out real --folds 0 --quiet",
    );
    assert!(!fs::read_to_string(at.join("real/report.html")).unwrap().contains("<p class=\"simulated\""));
    done(at, "certificate real --out of-real");
    let said = done(at, "check run.dbbd --robot real/robot-identified.toml --out check");
    assert!(said.contains(&"W1851".to_owned()), "{said:?}");
    let check = fs::read_to_string(at.join("check/check.html")).unwrap();
    assert!(check.contains("<p class=\"simulated\""));
    // The check beside the result counts: its readings are simulated.
    let refused = dbbd(at, &["certificate", "real", "--out", "of-checked"]);
    assert_eq!(codes(&refused).last().map(String::as_str), Some("E2008"), "{}", stderr(&refused));
}

/// A bar that another program plays is a real one; the virtual bar says what it is on every kind of line.
#[test]
fn only_the_virtual_bar_is_simulated() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        let (mut host, _) = listener.accept().unwrap();
        for count in 0..600 {
            let body = format!("{count},{},1.2345,0,0,20.00", count * 5000);
            if host.write_all(format!("{body}\r\n").as_bytes()).is_err() {
                return;
            }
            thread::sleep(std::time::Duration::from_millis(5));
        }
    });
    let record = |port: &str, protocol: &str, out: &str| {
        let args = format!("acquire --port {port} --protocol {protocol} --duration 1 --out {out} --quiet");
        dbbd(at, &args.split_whitespace().collect::<Vec<_>>())
    };
    record(&format!("tcp://127.0.0.1:{port}"), "dbb-csv-1", "played.dbbd");
    assert_eq!(origin(at, "played.dbbd"), "measured");
    for protocol in ["dbb-cobs-1", "dbb-csv-1", "touchdro", "usdigital-qsb"] {
        for line in ["--link=bar", "--listen=tcp://127.0.0.1:0", "--listen=rfc2217://127.0.0.1:0"] {
            let simulator = simulate(at, "1", &["--protocol", protocol, line]);
            let out = format!("{protocol}{}.dbbd", &line[line.len() - 3..].replace([':', '/'], "-"));
            let out = format!("{}-{out}", if line.contains("rfc") { "r" } else { "t" });
            record(&simulator.port, protocol, &out);
            assert_eq!(origin(at, &out), "simulated", "{protocol} {line}");
            let shown = dbbd(at, &["info", &out, "--json"]);
            let info: Value = serde_json::from_slice(&shown.stdout).unwrap();
            // Replies that a definition ignores are none.
            let faults = info["faults"].as_object().unwrap();
            assert!(faults.keys().all(|kind| kind == "ignored"), "{protocol} {line}: {faults:?}");
        }
    }
    // A capture of an older version says nothing.
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/captures/run.dbbd");
    assert_eq!(origin(at, old.to_str().unwrap()), Value::Null);
}
