//! Bad input: a message with file, line and reason, exit code 1, no panic.

use std::fs;
use std::path::Path;
use std::process::Output;

use tempfile::tempdir;

use crate::cell::{CENTRE, DESIGNED, codes, dbbd, horizontal, measure, stderr, three_planes, with_errors};

const HEADER: &str = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm,sigma_mm\n";
const ROW: &str = "1,1,0,-60,90,0,60,0,300.1,0.01\n";

fn identify(dir: &Path, observations: &str, more: &[&str]) -> Output {
    fs::write(dir.join("obs.csv"), observations).unwrap();
    identify_file(dir, "obs.csv", more)
}

fn identify_file(dir: &Path, name: &str, more: &[&str]) -> Output {
    fs::write(dir.join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,1300,0,800\n").unwrap();
    dbbd(dir, &[&["identify", name, "--centres", "C.csv", "--out", "out"], more].concat())
}

/// The file is read row by row, and the error names the row.
#[test]
fn binary_observations() {
    let dir = tempdir().unwrap();
    let refused = |row: &[u8], code: &str, place: &str| {
        let bytes = [HEADER.as_bytes(), ROW.as_bytes(), row].concat();
        fs::write(dir.path().join("bytes.csv"), bytes).unwrap();
        let output = identify_file(dir.path(), "bytes.csv", &["--robot", "kr60ha", "--tool", "30,20,10"]);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec![code.to_owned()]));
        assert!(stderr(&output).contains(place), "{}", stderr(&output));
    };
    refused(b"2,1,0,-60,90,0,60,0,30\xff,0.01\n", "E0111", "bytes.csv:3:21:");
    refused(b"2,1,0,-60,90,0,60,0,300,0.0\0\n", "E0103", "bytes.csv:3:");
    let absent = identify_file(dir.path(), "absent.csv", &["--robot", "kr60ha", "--tool", "30,20,10"]);
    assert_eq!(codes(&absent), ["E0101"]);
}

/// Lengths between 298 and 302 mm at poses about the ball, by the nominal robot; then the same table in other units.
#[test]
fn plans_and_tables_in_other_units() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/paper");
    let text = fs::read_to_string(example.join("observations.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(text.as_bytes());
    let header = rows.headers().unwrap().clone();
    let records: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    let table = |factor: &dyn Fn(&str) -> f64| {
        let lines = records.iter().map(|record| {
            let cells = header.iter().zip(record).map(|(name, cell)| match factor(name) {
                1.0 => cell.to_owned(),
                factor => (cell.parse::<f64>().unwrap() * factor).to_string(),
            });
            cells.collect::<Vec<_>>().join(",") + "\n"
        });
        header.iter().collect::<Vec<_>>().join(",") + "\n" + &lines.collect::<String>()
    };
    let centres = example.join("centres.csv");
    let refused = |table: &str, more: &[&str], place: &str| {
        let dir = tempdir().unwrap();
        fs::write(dir.path().join("bad.csv"), table).unwrap();
        fs::write(dir.path().join("obs.csv"), &text).unwrap();
        let given = [
            "--robot",
            "kr60ha",
            "--tool",
            "30,20,10",
            "--centres",
            centres.to_str().unwrap(),
            "--out",
            "out",
        ];
        let output = dbbd(dir.path(), &[&["identify"], more, &given].concat());
        let said = stderr(&output);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E1204".to_owned()]), "{said}");
        assert!(said.contains(place), "{said}");
    };
    for (column, factor, unit) in [
        ("length_mm", 1e-3, "metres"),
        ("length_mm", 0.1, "centimetres"),
        ("length_mm", 1.0 / 25.4, "inches"),
        ("_deg", 1_f64.to_radians(), "radians"),
        ("_deg", 1.0 / 0.9, "gon"),
    ] {
        let table = table(&|name| if name.ends_with(column) { factor } else { 1.0 });
        refused(&table, &["bad.csv"], unit);
        // Validation data is checked in the same way.
        refused(&table, &["obs.csv", "--validate", "bad.csv"], unit);
    }
    let planned =
        records.iter().map(|record| record.iter().collect::<Vec<_>>().join(",") + ",measure,ptp,0.5\n");
    let header = header.iter().collect::<Vec<_>>().join(",") + ",kind,move,dwell_s\n";
    let plan = header + &planned.collect::<String>();
    refused(&plan, &["bad.csv"], "bad.csv");
    refused(&plan, &["obs.csv", "--validate", "bad.csv"], "bad.csv");
}

/// Tables of measurements that are refused: the rows, the code and the line, 0 for the whole file.
const TABLES: &[(&str, &str, usize)] = &[
    ("1,1,0,-60,90,0,60,0,300.1,0.01\n2,1,0,-60,NaN,0,60,0,300,0.01\n", "E0111", 3),
    ("1,1,0,-60,90,0,60,0,300.1,0.01\n2,1,0,-60,inf,0,60,0,300,0.01\n", "E0111", 3),
    ("1,1,0,-60,90,0,60,0,-300,0.01\n", "E0111", 2),
    ("1,1,0,-60,90,0,60,0,300,0\n", "E0111", 2),
    ("1,0,0,-60,90,0,60,0,300,0.01\n", "E0111", 2),
    ("1,1,0,-60,90,0,60\n", "E0112", 2),
    // Decimal commas, thousands separators, two decimal marks, an open quote.
    ("1,1,0,0,-60,0,90,0,0,0,60,0,0,0,300,1,0,01\n", "E0112", 2),
    ("1,1,0,-60,90,0,60,0,\"1.300,1\",0.01\n", "E0111", 2),
    ("1,1,0,-60,90,0,60,0,300.1,0.01\n2,1,0,-60,90,0,60,0,\"300,1\",0.01\n", "E0111", 3),
    ("1,1,0,-60,90,0,60,0,\"300.1,0.01\n2,1,0,-60,90,0,60,0,300,0.01\n", "E0112", 2),
    ("1,2,0,-60,90,0,60,0,300,0.01\n", "E1203", 0),
    ("1,2000,0,-60,90,0,60,0,300,0.01\n", "E1202", 0),
    ("", "E1201", 0),
];

/// Arguments that are refused with a valid table.
const ARGUMENTS: &[(&[&str], &str)] = &[
    (&["--robot", "kr60"], "E0503"),
    (&["--robot", "nowhere.toml"], "E0101"),
    (&["--robot", "kr60ha", "--tool", "30,20,10", "--estimate", "alpha9"], "E0501"),
    (&["--robot", "kr60ha", "--tool", "30,20,10", "--estimate", "centre2_x"], "E0502"),
    (&["--robot", "kr60ha", "--tool", "30,20,10", "--prior", "nowhere.csv"], "E0101"),
];

/// Robot files that are refused: replacements in a valid one.
const ROBOTS: &[(&str, &str, &str)] = &[
    ("a_mm = 350.0", "a_mn = 350.0", "E0120"),
    ("[[joint]]", "[[joints]]", "E0120"),
    ("a_mm = 350.0", "a_mm = nan", "E0130"),
    ("a_mm = 350.0", "a_mm = 1e300", "E0130"),
    ("a_mm = 350.0", "a_mm = 350000.0", "E0130"),
    ("[-135.0, 35.0]", "[-1e300, 1e300]", "E0505"),
    ("sign = -1", "sign = 2", "E0505"),
    ("[-135.0, 35.0]", "[35.0, -135.0]", "E0505"),
    ("modified-dh", "standard-dh", "E0504"),
];

fn refused(observations: &str, more: &[&str], code: &str, place: &str) {
    let dir = tempdir().unwrap();
    let output = identify(dir.path(), observations, more);
    assert_eq!(
        (output.status.code(), codes(&output)),
        (Some(1), vec![code.to_owned()]),
        "{}",
        stderr(&output)
    );
    assert!(stderr(&output).contains(place), "`{place}` is not in: {}", stderr(&output));
}

#[test]
fn observations() {
    let robot = ["--robot", "kr60ha", "--tool", "30,20,10"];
    for (rows, code, line) in TABLES {
        let place = if *line > 0 { format!("obs.csv:{line}") } else { "obs.csv".into() };
        refused(&format!("{HEADER}{rows}"), &robot, code, &place);
    }
    let missing = HEADER.replace(",length_mm", "") + "1,1,0,-60,90,0,60,0,0.01\n";
    refused(&missing, &robot, "E0110", "obs.csv:1");
    refused("", &robot, "E0110", "obs.csv");
    let barred = HEADER.replace("sigma_mm", "bar") + "1,1,0,-60,90,0,60,0,300,2\n";
    refused(&barred, &robot, "E1202", "obs.csv");
    let bars: String = (1..=300).map(|bar| format!("{bar},1,0,-60,90,0,60,0,300,{bar}\n")).collect();
    refused(&(HEADER.replace("sigma_mm", "bar") + &bars), &robot, "E1202", "obs.csv");
    let approached = HEADER.replace("sigma_mm", "approach3") + "1,1,0,-60,90,0,60,0,300,up\n";
    refused(&approached, &robot, "E1205", "obs.csv:2");
}

#[test]
fn robots_parameter_lists_and_numbers() {
    let good = format!("{HEADER}{ROW}");
    for (arguments, code) in ARGUMENTS {
        refused(&good, arguments, code, "");
    }
    let nameless = identify(tempdir().unwrap().path(), &good, &[]);
    assert_eq!((nameless.status.code(), codes(&nameless)), (Some(1), vec!["E1302".to_owned()]));
    let dir = tempdir().unwrap();
    // Twenty times the same pose cannot be held out.
    let same: String = (0..20).map(|i| ROW.replacen("1", &(i + 1).to_string(), 1)).collect();
    let output =
        identify(dir.path(), &format!("{HEADER}{same}"), &["--robot", "kr60ha", "--tool", "30,20,10"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    // One length is not an error of the file: the result has a warning.
    let output =
        identify(dir.path(), &good, &["--robot", "kr60ha", "--tool", "30,20,10", "--estimate", "geometric"]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("W1315"), "{said}");
    let output = identify(dir.path(), &good, &["--robot", "kr60ha", "--tool", "30,20,10", "--sigma", "-1"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}

#[test]
fn robot_files() {
    let dir = tempdir().unwrap();
    let text = crate::cell::KR60HA;
    let cut = (text[..text.len() / 2].to_owned(), &"E0120");
    // SCARA, a palletiser without axis 6, an arm with seven axes.
    let (head, joints) = text.split_at(text.find("[[joint]]").unwrap());
    let (joints, tail) = joints.split_at(joints.find("[tolerance]").unwrap());
    let joints: Vec<&str> = joints.split_inclusive("\n\n").collect();
    assert_eq!(joints.len(), 6);
    let with = |count: usize| {
        let joints: String = joints.iter().cycle().take(count).copied().collect();
        (format!("{head}{joints}{tail}"), &"E0504")
    };
    let counts = [1, 4, 5, 7].map(with);
    let changed = ROBOTS.iter().map(|(was, is, code)| (text.replacen(was, is, 1), code));
    for (text, code) in changed.chain([cut]).chain(counts) {
        fs::write(dir.path().join("bad.toml"), text).unwrap();
        let output = identify(dir.path(), &format!("{HEADER}{ROW}"), &["--robot", "bad.toml"]);
        assert_eq!(
            (output.status.code(), codes(&output)),
            (Some(1), vec![(*code).to_owned()]),
            "{}",
            stderr(&output)
        );
        assert!(stderr(&output).contains("bad.toml"), "{}", stderr(&output));
    }
}

#[test]
fn captures_ports_and_programs() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("torn.dbbd"), b"this is no capture").unwrap();
    fs::write(
        at.join("P.src"),
        "DEF P ( )\r\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\nFROBNICATE 3\r\nEND\r\n",
    )
    .unwrap();
    let demo = include_str!("../../examples/circles.toml");
    for (name, from, to) in [
        ("job.toml", "\"dbb-cobs-1\"", "\"dbb-cops-1\""),
        ("mistyped.toml", "robot = \"kr60ha\"", "robot = \"kr60hb\""),
        ("elsewhere.toml", "robot = \"kr60ha\"", "robot = \"there.toml\""),
        ("loaded.toml", "robot = \"kr60ha\"", "robot = \"kr60ha\"\npayload = \"gripper\""),
    ] {
        assert!(demo.contains(from));
        fs::write(at.join(name), demo.replace(from, to)).unwrap();
    }
    fs::write(at.join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,1300,0,800\n").unwrap();
    let huge: String = (0..20).map(|at| format!("{at},1,0,-60,{at},0,60,0,1e300,0.01\n")).collect();
    fs::write(at.join("huge.csv"), format!("{HEADER}{huge}")).unwrap();
    fs::write(at.join("circles.toml"), include_str!("../../examples/circles.toml")).unwrap();
    // Command, code, and a word of the message.
    let cases: &[(&[&str], &str, &str)] = &[
        (&["plan", "job.toml", "--out", "p"], "E0301", "did you mean `dbb-cobs-1`"),
        (&["plan", "job.toml", "--out", "p"], "E0301", "job.toml:23:"),
        (&["plan", "mistyped.toml", "--out", "p"], "E0503", "mistyped.toml:4:"),
        (&["plan", "elsewhere.toml", "--out", "p"], "E0101", "`robot` in elsewhere.toml:4 names this file"),
        (&["plan", "loaded.toml", "--out", "p"], "E0582", "loaded.toml:5:"),
        (&["plan", "circles.toml", "--out", "p", "--measured", "huge.csv"], "E0721", ""),
        (&["sync", "torn.dbbd", "--out", "o.csv"], "E0405", "torn.dbbd"),
        (&["info", "nowhere.dbbd"], "E0101", "nowhere.dbbd"),
        (&["acquire", "--port", "/dev/nowhere0", "--out", "r.dbbd"], "E0201", "/dev/nowhere0"),
        (&["simulate", "--program", "P.src"], "E0803", "P.src:3"),
        (&["plan", "nowhere.toml", "--out", "p"], "E0101", "nowhere.toml"),
        (&["plan", "C.csv", "--out", "p"], "E0120", "is a .csv meant?"),
        (&["krl", "C.csv", "--out", "k"], "E0730", "C.json"),
        (&["robots", "show", "kr61ha"], "E0503", "kr61ha"),
        (&["compensate", "P.src", "--robot", "kr60ha", "--out", "c"], "E0909", "kr60ha"),
        (&["protocols", "show", "dbb-cobs-9"], "E0301", "dbb-cobs-9"),
        (&["demo", "--out", "C.csv/demo"], "E0102", "C.csv/demo"),
    ];
    let mut wrong = Vec::new();
    for (args, code, words) in cases {
        let output = dbbd(at, args);
        let said = stderr(&output);
        if (output.status.code(), codes(&output)) != (Some(1), vec![(*code).to_owned()])
            || !said.contains(words)
        {
            wrong.push(format!("dbbd {}: {:?} {said}", args.join(" "), output.status.code()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    for (option, value, code) in [("--expansion", "12", "E0130"), ("--radius", "0", "E0003")] {
        let refused = dbbd(at, &["circle", "C.csv", option, value, "--out", "c"]);
        assert_eq!((refused.status.code(), codes(&refused)), (Some(2), vec![code.to_owned()]));
    }
    let checked = dbbd(at, &["robots", "check", "kr60ha"]);
    assert_eq!(checked.status.code(), Some(0), "{}", stderr(&checked));
    assert!(!at.join("r.dbbd").exists(), "nothing was measured, so there is no capture");
}

/// Estimates no parameter of the robot: no observability index, no correlation, and no panic.
#[test]
fn bar_checks() {
    let dir = tempdir().unwrap();
    let truth = with_errors(DESIGNED);
    let text = measure(&truth, &[horizontal(1, CENTRE)], 40, 25.0).to_csv();
    for list in ["bar", "tool", "centres", "gear"] {
        let more = ["--robot", "kr60ha", "--tool", "30,20,10", "--prior", "datasheet", "--estimate", list];
        let output = identify(dir.path(), &text, &more);
        let (code, said) = (output.status.code(), stderr(&output));
        assert!(matches!(code, Some(0 | 3)) && !said.contains("panicked"), "{list}: {code:?} {said}");
    }
}

/// The lengths of one robot fit another one, with implausible links.
#[test]
fn runs_of_another_robot() {
    let dir = tempdir().unwrap();
    let text = measure(&with_errors(DESIGNED), &three_planes(1, CENTRE), 27, 25.0).to_csv();
    let output = identify(dir.path(), &text, &["--robot", "kr16-2", "--tool", "0,0,0"]);
    let said = stderr(&output);
    assert!(output.status.code() == Some(3) && said.contains("W1312"), "{said}");
}

/// A pipe that nobody writes into, a device that never ends and a directory are refused at once.
#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe.toml");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let begun = dbbd_device::clock::now();
    for path in [pipe.to_str().unwrap(), "/dev/zero", "/dev/tty", "."] {
        for args in [
            &["plan", path, "--out", "out"][..],
            &["identify", path, "--robot", "kr60ha", "--tool", "30,20,10", "--out", "out"],
            &["identify", "none.csv", "--robot", path, "--out", "out"],
            &["info", path],
            &["sync", path, "--out", "out.csv"],
            &["serve", "--check", "--config", path],
            &["robots", "check", path],
        ] {
            let output = crate::cell::dbbd(dir.path(), args);
            let codes = crate::cell::codes(&output);
            assert_eq!(output.status.code(), Some(1), "{args:?}: {}", crate::cell::stderr(&output));
            assert!(codes.iter().any(|code| code.starts_with("E0")), "{args:?}: {codes:?}");
        }
    }
    assert!(dbbd_device::clock::now().seconds_since(begun) < 30.0);
}

/// A table that a person typed, or edited, is moved aside; unedited output is replaced.
#[test]
fn sync_replaces_only_its_own_unedited_table() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    let done = |args: &str| {
        let output = crate::cell::dbbd(at, &args.split_whitespace().collect::<Vec<_>>());
        assert!(matches!(output.status.code(), Some(0 | 3)), "{args}: {}", crate::cell::stderr(&output));
        crate::cell::codes(&output)
    };
    let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\n[[centre]]\nid = 1\n\
        xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 12\namplitude_deg = 25.0\ntilt_deg = 30.0\n";
    std::fs::write(at.join("job.toml"), job).unwrap();
    done("plan job.toml --out plan --quiet");
    done("acquire --port sim --plan plan/plan.csv --out run.dbbd --quiet");
    let read = |name: &str| std::fs::read_to_string(at.join(name)).unwrap();
    let moved = "I1849".to_owned();
    let typed = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm\n1,1,1,2,3,4,5,6,300\n";
    std::fs::write(at.join("lengths.csv"), typed).unwrap();
    assert!(done("sync run.dbbd --out lengths.csv").contains(&moved));
    assert_eq!(read("previous-1-lengths.csv"), typed);
    let own = read("lengths.csv");
    assert!(!done("sync run.dbbd --out lengths.csv").contains(&moved));
    assert_eq!(read("lengths.csv"), own);
    let edited = format!("{own}\n");
    std::fs::write(at.join("lengths.csv"), &edited).unwrap();
    assert!(done("sync run.dbbd --out lengths.csv").contains(&moved));
    assert_eq!((read("previous-2-lengths.csv"), read("lengths.csv")), (edited, own));
    assert!(
        at.join("previous-2-lengths.provenance.json").is_file()
            && !at.join("previous-3-lengths.csv").exists()
    );
}

/// A plan is named by its directory or one of its two files; another file of ours is named for what it is.
#[test]
fn a_file_of_another_kind_is_recognised() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    let run = |args: &str| crate::cell::dbbd(at, &args.split_whitespace().collect::<Vec<_>>());
    let job = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\n[[centre]]\nid = 1\n\
        xyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 12\namplitude_deg = 25.0\ntilt_deg = 30.0\n";
    std::fs::write(at.join("job.toml"), job).unwrap();
    std::fs::write(at.join("other.toml"), "key = 1\n").unwrap();
    for args in ["plan job.toml --out plan", "robots import kr60ha --out robot.toml"] {
        assert_eq!(run(args).status.code(), Some(0), "{args}");
    }
    for plan in ["plan", "plan/plan.csv", "plan/plan.json"] {
        let output = run(&format!("krl {plan} --out krl --replace"));
        assert!(matches!(output.status.code(), Some(0 | 3)), "{plan}: {}", crate::cell::stderr(&output));
    }
    for (args, code) in [
        ("krl job.toml --out krl", "E0104"),
        ("krl robot.toml --out krl", "E0104"),
        ("krl other.toml --out krl", "E0730"),
        ("acquire --port sim --plan job.toml --out run.dbbd", "E0104"),
        ("plan plan/plan.json --out other", "E0104"),
        ("plan plan/plan.csv --out other", "E0104"),
        ("plan robot.toml --out other", "E0104"),
        ("plan other.toml --out other", "E0120"),
        ("plan job.toml --robot job.toml --out other", "E0104"),
    ] {
        let output = run(args);
        assert_eq!(output.status.code(), Some(1), "{args}");
        let found = crate::cell::codes(&output);
        assert!(found.iter().any(|found| found == code), "{args}: {}", crate::cell::stderr(&output));
    }
}
