//! A program reports its dwells over EthernetKRL: however TCP splits the telegrams, and whatever else a client
//! sends or
//! omits, each report is recorded once, answered, and used.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::Child;
use std::time::Duration;

use dbbd_job::recording::RecordingFinding::{
    TelegramLacks, TelegramNotAngle, TelegramNotQuoted, TelegramNotWhole, TelegramPhase,
};
use dbbd_job::recording::capture::{CaptureRecord, RunEvent};
use dbbd_job::recording::{LONGEST_TELEGRAM, Telegram, TelegramReader, TelegramResult};
use dbbd_model::diagnostic::Finding;
use dbbd_model::measurement::Measurements;
use proptest::prelude::*;

use crate::cell::{codes, dbbd, stderr};
use crate::process::{Simulator, signal, spawn};

/// As written by `krl --sync ekrl` and the controller's EKI (reference: the channel file, docs/reference/krl.md).
fn written(telegram: &Telegram) -> String {
    let [a1, a2, a3, a4, a5, a6] = telegram.axes_deg;
    format!(
        "<Dbb><Pt Run=\"{}\" Id=\"{}\" Ph=\"{}\"></Pt><Ax A1=\"{a1:.6}\" A2=\"{a2:.6}\" A3=\"{a3:.6}\" \
         A4=\"{a4:.6}\" A5=\"{a5:.6}\" A6=\"{a6:.6}\"></Ax></Dbb>",
        telegram.run, telegram.index, telegram.phase
    )
}

fn telegram(index: u32, phase: u8) -> Telegram {
    Telegram { run: 4660, index, phase, axes_deg: [1.5, -90.25, 90.125, 0.0, -0.5, f64::from(index)] }
}

fn telegrams(heard: &[TelegramResult]) -> Vec<Telegram> {
    let of = |heard: &TelegramResult| match heard {
        TelegramResult::Telegram(telegram) => Some(*telegram),
        TelegramResult::Malformed(_) => None,
    };
    heard.iter().filter_map(of).collect()
}

/// Content between two telegrams: nothing, space, garbage, an interrupted telegram, an invalid one, one without
/// an end.
fn between() -> impl Strategy<Value = Vec<u8>> {
    let cut = (1usize..60).prop_map(|len| written(&telegram(7, 1)).into_bytes()[..len].to_vec());
    prop_oneof![
        Just(Vec::new()),
        Just(b" \r\n\t".to_vec()),
        proptest::collection::vec(
            any::<u8>().prop_filter("no begin of a telegram", |byte| *byte != b'<'),
            0..80
        ),
        Just(b"<Dbbx><Dbb<<D<Db".to_vec()),
        Just(b"<?xml version=\"1.0\"?><!-- hello --><Robot><Status>1</Status></Robot>".to_vec()),
        Just(b"<Dbb><Pt Run=\"x\" Id=\"1\" Ph=\"1\"/></Dbb>".to_vec()),
        Just(b"<Dbb/>".to_vec()),
        cut,
        (1usize..3 * LONGEST_TELEGRAM).prop_map(|len| [b"<Dbb ".to_vec(), vec![b'x'; len]].concat()),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: proptest::test_runner::RngSeed::Fixed(5), ..ProptestConfig::default() })]

    #[test]
    fn telegrams_do_not_depend_on_splits(
        parts in proptest::collection::vec((between(), 1u32..500, 1u8..=2), 0..12),
        cuts in proptest::collection::vec(1usize..200, 1..40),
    ) {
        let mut bytes = Vec::new();
        let mut sent = Vec::new();
        for (noise, index, phase) in &parts {
            bytes.extend(noise);
            sent.push(telegram(*index, *phase));
            bytes.extend(written(&telegram(*index, *phase)).into_bytes());
        }
        let whole = TelegramReader::default().push(&bytes);
        prop_assert_eq!(telegrams(&whole), sent);
        let mut reader = TelegramReader::default();
        let (mut heard, mut rest, mut at) = (Vec::new(), &bytes[..], 0);
        while !rest.is_empty() {
            let (now, later) = rest.split_at(cuts[at % cuts.len()].min(rest.len()));
            heard.extend(reader.push(now));
            prop_assert!(reader.pending() <= LONGEST_TELEGRAM);
            (rest, at) = (later, at + 1);
        }
        prop_assert_eq!(heard, whole);
    }

    #[test]
    fn any_bytes_of_a_client_are_accepted(bytes in proptest::collection::vec(any::<u8>(), 0..3000)) {
        let mut reader = TelegramReader::default();
        prop_assert!(telegrams(&reader.push(&bytes)).is_empty());
        prop_assert!(reader.skipped() + reader.pending() as u64 <= bytes.len() as u64);
        // The telegram after it is read.
        let after = written(&telegram(1, 2));
        prop_assert_eq!(telegrams(&reader.push(after.as_bytes())), vec![telegram(1, 2)]);
    }
}

#[test]
fn telegram_variants_and_errors() {
    let read = |text: &str| TelegramReader::default().push(text.as_bytes());
    let axes = "A1='1' A2='2' A3='3' A4='4' A5='5' A6='-1.5E-3'";
    let other = format!("<Dbb >\n <Ax {axes} />\n <Pt Ph = '2' Id='3' Run='9' />\n</Dbb >");
    let expected = Telegram { run: 9, index: 3, phase: 2, axes_deg: [1.0, 2.0, 3.0, 4.0, 5.0, -0.0015] };
    assert_eq!(read(&other), [TelegramResult::Telegram(expected)]);
    let good = "<Dbb><Pt Run=\"1\" Id=\"2\" Ph=\"1\"/><Ax A1=\"0\" A2=\"0\" A3=\"0\" A4=\"0\" A5=\"0\" A6=\"0\"/></Dbb>";
    assert_eq!(telegrams(&read(good)).len(), 1);
    for (from, to, why) in [
        ("Id=\"2\" ", "", TelegramLacks { element: "Pt".into(), name: "Id".into() }),
        ("Id=\"2\"", "Id=\"-2\"", TelegramNotWhole { name: "Id".into(), value: "-2".into() }),
        ("Ph=\"1\"", "Ph=\"3\"", TelegramPhase { phase: 3 }),
        ("A3=\"0\"", "A3=\"nan\"", TelegramNotAngle { name: "A3".into(), value: "nan".into() }),
        ("A3=\"0\"", "A3=\"1e9\"", TelegramNotAngle { name: "A3".into(), value: "1e9".into() }),
        ("A3=\"0\"", "A3=0", TelegramNotQuoted { element: "Ax".into(), name: "A3".into() }),
        (" A6=\"0\"", "", TelegramLacks { element: "Ax".into(), name: "A6".into() }),
    ] {
        match &read(&good.replace(from, to))[..] {
            [TelegramResult::Malformed(said)] => assert_eq!((said, said.code().as_str()), (&why, "W0414")),
            other => panic!("{to}: {other:?}"),
        }
    }
}

/// A plan of a few dwells on a short arc, and its files.
fn small_plan(dir: &Path) -> u32 {
    let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
               [[circle]]\nplane = \"XY\"\npoints = 3\narc_deg = 10.0\norientation = \"fixed\"\ntilt_deg = 30.0\n[motion]\n\
               settle_s = 0.2\ndwell_s = 0.4\n";
    std::fs::write(dir.join("job.toml"), job).unwrap();
    let output = dbbd(dir, &["plan", "job.toml", "--out", "plan"]);
    assert!(output.status.code().is_some_and(|code| code == 0 || code == 3), "{}", stderr(&output));
    let rows = std::fs::read_to_string(dir.join("plan/plan.csv")).unwrap();
    let mut dwells = rows.lines().filter(|row| row.contains(",measure,") || row.contains(",reference,"));
    dwells.find_map(|row| row.split(',').next()?.parse().ok()).unwrap()
}

/// A simulated bar that does not move, and a run that listens.
struct Listening {
    _simulator: Simulator,
    acquire: Child,
    address: SocketAddr,
}

fn free_port() -> SocketAddr {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

fn listen(dir: &Path) -> Listening {
    let output = dbbd(dir, &["krl", "plan/plan.csv", "--out", "krl"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let simulator =
        Simulator::start(dir, &["--program", "krl/DBB_MAIN.src", "--link", "bar", "--halt", "600"]);
    let address = free_port();
    let fixed = ["acquire", "--port", "bar", "--plan", "plan/plan.csv", "--out", "run", "--duration", "30"];
    let acquire = spawn(dir, &[&fixed[..], &["--ekrl", &address.to_string()]].concat());
    Listening { _simulator: simulator, acquire, address }
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = (0..200)
        .find_map(|_| {
            let stream = TcpStream::connect(address).ok();
            if stream.is_none() {
                std::thread::sleep(Duration::from_millis(25));
            }
            stream
        })
        .expect("the run listens");
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream
}

/// Sends bytes, one write for each part, and reads one answer.
fn ask(stream: &mut TcpStream, parts: &[&str]) -> String {
    for part in parts {
        stream.write_all(part.as_bytes()).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    let mut answer = Vec::new();
    let mut byte = [0; 1];
    while answer.last() != Some(&b'\n') {
        stream.read_exact(&mut byte).unwrap();
        answer.push(byte[0]);
    }
    String::from_utf8(answer).unwrap()
}

#[test]
fn idle_connections_do_not_block_the_controller() {
    let dir = tempfile::tempdir().unwrap();
    let index = small_plan(dir.path());
    let json = std::fs::read_to_string(dir.path().join("plan/plan.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let run = u32::from_str_radix(&json["hash"].as_str().unwrap()[..6], 16).unwrap();
    let Listening { _simulator, mut acquire, address } = listen(dir.path());
    let good = |phase| written(&Telegram { run, ..telegram(index, phase) });
    let mut first = connect(address);
    assert_eq!(ask(&mut first, &[&good(1)]), format!("<Ack Id=\"{index}\"/>\n"));
    // More than the limit; they stay open and send nothing.
    let idle: Vec<TcpStream> = (0..12).map(|_| connect(address)).collect();
    assert_eq!(ask(&mut first, &[&good(2)]), format!("<Ack Id=\"{index}\"/>\n"));
    let mut second = connect(address);
    assert_eq!(ask(&mut second, &[&good(1)]), format!("<Ack Id=\"{index}\"/>\n"));
    drop(idle);
    acquire.kill().unwrap();
    acquire.wait().unwrap();
}

#[test]
fn misbehaving_client_loses_only_its_own_telegrams() {
    let dir = tempfile::tempdir().unwrap();
    let index = small_plan(dir.path());
    let json = std::fs::read_to_string(dir.path().join("plan/plan.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let run = u32::from_str_radix(&json["hash"].as_str().unwrap()[..6], 16).unwrap();
    let Listening { _simulator, acquire, address } = listen(dir.path());
    let good = |phase| written(&Telegram { run, ..telegram(index, phase) });

    // Wait until the server accepts connections.
    let mut first = connect(address);
    let taken =
        dbbd(dir.path(), &["acquire", "--port", "bar", "--ekrl", &address.to_string(), "--out", "third"]);
    assert_eq!((taken.status.code(), codes(&taken)), (Some(1), vec!["E0207".to_owned()]));
    assert!(!dir.path().join("third").exists());

    let whole = good(1);
    let (head, tail) = whole.split_at(17);
    assert_eq!(ask(&mut first, &["rubbish ", head, tail]), format!("<Ack Id=\"{index}\"/>\n"));
    // Of another plan; of a row without a dwell; unreadable: the program must halt.
    let foreign = written(&Telegram { run: run ^ 1, ..telegram(index, 1) });
    assert_eq!(ask(&mut first, &[&foreign]), "<Ack Id=\"0\"/>\n");
    let nowhere = written(&Telegram { run, ..telegram(999, 1) });
    assert_eq!(ask(&mut first, &[&nowhere]), "<Ack Id=\"0\"/>\n");
    assert_eq!(ask(&mut first, &["<Dbb><Pt/></Dbb>"]), "<Ack Id=\"0\"/>\n");
    // Disconnected within a telegram, and back, like a controller after power-off.
    first.write_all(&good(2).as_bytes()[..40]).unwrap();
    drop(first);
    let mut second = connect(address);
    assert_eq!(ask(&mut second, &[&good(2)]), format!("<Ack Id=\"{index}\"/>\n"));
    // Two telegrams in one write, and one without an end.
    second.write_all((good(1) + &good(2)).as_bytes()).unwrap();
    assert_eq!(ask(&mut second, &[]) + &ask(&mut second, &[]), format!("<Ack Id=\"{index}\"/>\n").repeat(2));
    second.write_all(&[b"<Dbb ".to_vec(), vec![b'x'; 100_000]].concat()).unwrap();
    assert_eq!(ask(&mut second, &[&good(1)]), format!("<Ack Id=\"{index}\"/>\n"));

    signal(&acquire, "INT");
    let output = acquire.wait_with_output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("2 telegrams were refused"), "{said}");
    let capture = dbbd_job::recording::capture::read_capture(&std::fs::read(dir.path().join("run")).unwrap());
    let told: Vec<(u32, u8)> = capture
        .records
        .iter()
        .filter_map(|stamped| match &stamped.record {
            CaptureRecord::Event(RunEvent::Controller { index, phase, axes_deg }) => {
                assert_eq!(axes_deg[1], -90.25);
                Some((*index, *phase))
            }
            _ => None,
        })
        .collect();
    assert_eq!(told, [(index, 1), (index, 2), (index, 1), (index, 2), (index, 1)]);
    let marks: String = capture
        .records
        .iter()
        .filter_map(|stamped| match &stamped.record {
            CaptureRecord::Event(RunEvent::Mark { text }) => Some(format!("{text}\n")),
            _ => None,
        })
        .collect();
    for words in [
        "in the middle of a telegram (40 bytes)",
        "it is of run",
        "is no dwell",
        "not understood",
        "has connected",
    ] {
        assert!(marks.contains(words), "{words} in {marks}");
    }
}

#[test]
fn unusable_addresses_are_refused_with_a_code() {
    let dir = tempfile::tempdir().unwrap();
    for (address, code, words) in
        [("192.0.2.1:1", 1, "cannot listen"), ("nowhere", 2, "invalid value 'nowhere'")]
    {
        let output = dbbd(dir.path(), &["acquire", "--port", "none", "--ekrl", address, "--out", "run"]);
        assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
        assert!(stderr(&output).contains(words), "{}", stderr(&output));
    }
}

/// The whole chain in real time: plan, program, simulated controller as the client, acquisition as the server,
/// dwells by
/// reports, measured axes in the observations.
#[test]
fn plan_program_controller_and_capture_agree() {
    let dir = tempfile::tempdir().unwrap();
    small_plan(dir.path());
    let output = dbbd(
        dir.path(),
        &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--ekrl", "127.0.0.1:0", "--out", "run"],
    );
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let output = dbbd(dir.path(), &["sync", "run", "--out", "obs.csv"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("dwells by the controller's reports"), "{said}");
    let observations = std::fs::read_to_string(dir.path().join("obs.csv")).unwrap();
    let observations = Measurements::from_csv("obs.csv", &observations).unwrap();
    let plan = std::fs::read_to_string(dir.path().join("plan/plan.csv")).unwrap();
    let dwells = plan.lines().filter(|row| row.contains(",measure,") || row.contains(",reference,")).count();
    assert_eq!(observations.rows.len(), dwells, "{said}");
    for row in &observations.rows {
        // The telegram has six decimals, the plan more: these are the measured ones.
        assert!(row.axes.degrees().iter().all(|deg| (deg * 1e6 - (deg * 1e6).round()).abs() < 1e-3));
    }
}
