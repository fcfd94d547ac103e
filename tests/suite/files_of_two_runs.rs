//! Files of two runs, robots or plans that are used together are refused or reported.

use std::fs;

use crate::cell::{codes, dbbd, stderr};
use crate::nothing_wrong_is_silent::{JOB, cell, identify, says};

const PRIOR: [&str; 2] = ["--prior", "datasheet"];

#[test]
fn modules_of_two_plans() {
    let (dir, data) = cell();
    let at = dir.path();
    assert_eq!(identify(at, &data.to_csv(), &PRIOR).status.code(), Some(0));
    fs::write(at.join("other.toml"), JOB.replace("points = 3", "points = 4")).unwrap();
    for (job, plan, krl) in [("job.toml", "plan", "krl"), ("other.toml", "plan2", "krl2")] {
        assert_eq!(dbbd(at, &["plan", job, "--out", plan]).status.code(), Some(0));
        let plan = format!("{plan}/plan.csv");
        assert_ne!(dbbd(at, &["krl", "--replace", &plan, "--out", krl]).status.code(), Some(1));
    }
    let correct = || {
        let robot = "out/robot-identified.toml";
        dbbd(
            at,
            &[
                "compensate",
                "--replace",
                "krl/DBB_C001.src",
                "--robot",
                robot,
                "--out",
                "new",
                "--limit",
                "50",
            ],
        )
    };
    // The lengths are those of the nominal robot: there is nothing to correct.
    says(&correct(), 3, "W0918");
    fs::copy(at.join("krl2/DBB_C001.dat"), at.join("krl/DBB_C001.dat")).unwrap();
    says(&correct(), 1, "E0806");
}

#[test]
fn results_of_two_robots() {
    let (dir, data) = cell();
    let at = dir.path();
    let run = |serial: &str, out: &str| {
        fs::write(at.join("id.toml"), format!("robot = \"{serial}\"\nmeasured = \"2026-01-05\"\n[bar]\nlength_u_mm = 0.002\nserial = \"B-1\"\n")).unwrap();
        let more = ["--identity", "id.toml", "--sigma", if out == "first" { "0.002" } else { "0.003" }];
        let output = identify(at, &data.to_csv(), &[&PRIOR[..], &more].concat());
        if output.status.code() != Some(1) {
            fs::rename(at.join("out"), at.join(out)).unwrap();
        }
        output
    };
    for (serial, out) in [("R-1", "first"), ("R-2", "second")] {
        assert_ne!(run(serial, out).status.code(), Some(1));
    }
    let compare = |more: &[&str]| dbbd(at, &[&["compare", "first", "second", "--out", "c"], more].concat());
    says(&compare(&[]), 1, "E1802");
    fs::rename(at.join("second"), at.join("out")).unwrap();
    // The calibration of the other robot is not replaced.
    let before = fs::read(at.join("out/result.json")).unwrap();
    says(&run("R-1", "third"), 1, "E0181");
    assert_eq!(fs::read(at.join("out/result.json")).unwrap(), before);
    fs::remove_dir_all(at.join("out")).unwrap();
    assert_ne!(run("R-1", "again").status.code(), Some(1));
    let same = ["compare", "first", "again", "--out", "c"];
    says(&dbbd(at, &[&same[..], &["--repeat-u", "0.01"]].concat()), 1, "E1982");
    fs::write(at.join("again/result.json"), {
        let text = fs::read_to_string(at.join("again/result.json")).unwrap();
        text.split(",\n  \"sha256\": ").next().unwrap().to_owned() + "\n}\n"
    })
    .unwrap();
    says(&dbbd(at, &[&same[..], &["--dates", "2020-01-01,2021-01-01"]].concat()), 3, "W1907");
    for (key, wrong) in [("length_u_mm", "length_u_mm = 0.2"), ("serial", "serial = \"B-2\"")] {
        fs::write(at.join("wrong.toml"), format!("[bar]\n{wrong}\n")).unwrap();
        let certificate = ["certificate", "first/result.json", "--identity", "wrong.toml", "--out", "cert"];
        let output = dbbd(at, &certificate);
        assert!(codes(&output).contains(&"W2007".to_owned()), "{key}: {}", stderr(&output));
    }
    // An edited file is not shown as valid.
    let text = fs::read_to_string(at.join("first/result.json")).unwrap();
    fs::write(at.join("first/result.json"), text.replacen("R-1", "R-9", 1)).unwrap();
    says(&dbbd(at, &["info", "first/result.json"]), 1, "E1808");
    let text = fs::read_to_string(at.join("first/robot-identified.toml")).unwrap();
    fs::write(at.join("first/robot-identified.toml"), text.replacen("-135.0", "-115.0", 1)).unwrap();
    says(&dbbd(at, &["info", "first/robot-identified.toml"]), 3, "W1840");
}

#[test]
fn existing_files_that_are_no_results() {
    let (dir, data) = cell();
    let at = dir.path();
    let poses = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n10,-60,90,0,60,0\n";
    fs::write(at.join("poses.csv"), poses).unwrap();
    let predict = |out: &str| {
        dbbd(at, &["predict", "poses.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", out])
    };
    says(&predict("obs.csv"), 1, "E0181");
    assert_eq!(fs::read_to_string(at.join("obs.csv")).unwrap(), data.to_csv());
    for _ in 0..2 {
        assert_ne!(predict("p.csv").status.code(), Some(1));
    }
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    let rows =
        (0..1200).map(|row| format!("{},{}\n", f64::from(row) / 20.0, 300.0 + 0.001 * f64::from(row % 7)));
    fs::write(at.join("t.csv"), format!("t_s,length_mm\n{}", rows.collect::<String>())).unwrap();
    dbbd(at, &["import", "t.csv", "--plan", "plan/plan.csv", "--out", "run"]);
    says(&dbbd(at, &["sync", "run", "--out", "plan/plan.csv"]), 1, "E0181");
    fs::write(at.join("id.toml"), "[bar]\nlength_mm = 500.0\n").unwrap();
    let acquire =
        ["acquire", "--port", "/dev/null/none", "--plan", "plan/plan.csv", "--out", "r2", "--gone", "0"];
    let output = dbbd(at, &[&acquire[..], &["--identity", "id.toml"]].concat());
    assert!(codes(&output).contains(&"W1844".to_owned()), "{}", stderr(&output));
}

#[test]
fn rows_of_tables() {
    let (dir, data) = cell();
    let at = dir.path();
    let mut rounded = data.clone();
    for row in &mut rounded.rows {
        let deg = row.axes.degrees().map(|deg| (deg * 100.0).round() / 100.0);
        row.axes = dbbd_model::robot::AxisAngles::from_degrees(deg);
    }
    let output = identify(at, &rounded.to_csv(), &PRIOR);
    assert!(codes(&output).contains(&"I1284".to_owned()), "{}", stderr(&output));
    let mut sigma = data.clone();
    sigma.rows[7].sigma_mm = Some(100.0);
    says(&identify(at, &sigma.to_csv(), &PRIOR), 3, "W1280");
    fs::write(at.join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,900.0,700.0,1100.0\n").unwrap();
    let far = identify(at, &data.to_csv(), &PRIOR);
    assert!(codes(&far).contains(&"W1282".to_owned()), "{}", stderr(&far));
    let signs = crate::cell::KR60HA.replacen("sign = -1", "sign = 1", 1);
    fs::write(at.join("bad.toml"), signs).unwrap();
    says(&dbbd(at, &["robots", "check", "bad.toml"]), 3, "W0581");
    fs::write(at.join("empty.csv"), "").unwrap();
    says(
        &dbbd(
            at,
            &[
                "identify",
                "empty.csv",
                "--robot",
                "kr60ha",
                "--tool",
                "30,20,10",
                "--centres",
                "C.csv",
                "--out",
                "o",
            ],
        ),
        1,
        "E0110",
    );
    assert_eq!(identify(at, &data.to_csv(), &["--bar-u", "1e-6"]).status.code(), Some(2));
    for (from, to) in [
        ("length_u_mm = 0.002", "length_u_mm = 0.000002"),
        ("stroke_mm", "radius_mm = 0.015\nstroke_mm"),
        ("[tool]", "[tool]\narm_radius_mm = 0.15"),
    ] {
        fs::write(at.join("bad.toml"), JOB.replacen(from, to, 1)).unwrap();
        says(&dbbd(at, &["plan", "bad.toml", "--out", "plan"]), 1, "E0130");
    }
}

#[test]
fn directions_and_options_of_circles() {
    let (dir, _) = cell();
    let at = dir.path();
    let length =
        |point: u32| 300.0 + 0.05 * (0.17 * f64::from(point)).sin() + 0.004 * f64::from(point * 7 % 5);
    let both = |cw: u32, back: &str| {
        let there = (0..72).map(|point| format!("1,ccw,{},{}\n", 5 * point, length(point)));
        let again =
            (0..cw).map(|point| format!("1,{back},{},{}\n", 355 - 5 * point, length(71 - point) + 0.01));
        let rows: String = there.chain(again).collect();
        fs::write(at.join("c.csv"), format!("run,direction,angle_deg,length_mm\n{rows}")).unwrap();
    };
    let circle = |more: &[&str]| {
        dbbd(
            at,
            &[&["circle", "c.csv", "--out", "q", "--monte-carlo", "0", "--radius", "300"], more].concat(),
        )
    };
    both(72, "cw");
    let sound = circle(&[]);
    assert_eq!(sound.status.code(), Some(0), "{}", stderr(&sound));
    says(&circle(&["--sigma", "5e-7"]), 3, "W1482");
    says(&circle(&["--sigma", "0.5"]), 3, "W1482");
    for option in [["--certified", "22"], ["--expansion", "12e-6"], ["--machine-expansion", "12e-6"]] {
        says(&circle(&option), 1, "E1481");
    }
    assert_eq!(circle(&["--monte-carlo", "1"]).status.code(), Some(2));
    both(18, "cw");
    says(&circle(&[]), 3, "W1482");
    both(72, "ccw");
    says(&circle(&[]), 3, "W1482");
    let text = fs::read_to_string(at.join("q/circle.json")).unwrap();
    fs::create_dir(at.join("edited")).unwrap();
    fs::write(at.join("edited/circle.json"), text.replacen("\"G_lsc\": 0.", "\"G_lsc\": 0.9", 1)).unwrap();
    says(&dbbd(at, &["compare", "q", "edited", "--out", "c"]), 1, "E1808");
}

#[test]
fn traces_definitions_and_the_service() {
    let (dir, _) = cell();
    let at = dir.path();
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    let import = |unit: f64, temp_c: f64| {
        let length = |row: u32| (300.0 + 0.001 * f64::from(row % 7)) / unit;
        let rows = (0..1200).map(|row| format!("{},{},{temp_c}\n", f64::from(row) / 20.0, length(row)));
        fs::write(at.join("t.csv"), format!("t_s,length_mm,temp\n{}", rows.collect::<String>())).unwrap();
        fs::write(at.join("map.toml"), "[temperature]\ncolumn = \"temp\"\n").unwrap();
        let _ = fs::remove_file(at.join("run"));
        let given = ["import", "t.csv", "--mapping", "map.toml", "--plan", "plan/plan.csv", "--out", "run"];
        dbbd(at, &given)
    };
    says(&import(1000.0, 20.0), 3, "W1181");
    says(&import(25.4, 20.0), 1, "W1181");
    // Warmer than the certificate's temperature, and the job does not give the expansion of the bar.
    fs::write(at.join("job.toml"), JOB.replace("expansion_per_k = 12e-6\n", "")).unwrap();
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    assert_eq!(import(1.0, 35.0).status.code(), Some(0));
    let sync = dbbd(at, &["sync", "run", "--out", "o.csv"]);
    assert!(codes(&sync).contains(&"W0482".to_owned()), "{}", stderr(&sync));
    let text = include_str!("../../protocols/dbb-cobs-1.toml");
    let table: toml::Table = text.parse().unwrap();
    let bare: toml::Table = table.into_iter().filter(|(key, _)| key != "test").collect();
    fs::write(at.join("bare.toml"), toml::to_string(&bare).unwrap()).unwrap();
    let bare = dbbd(at, &["protocols", "check", "bare.toml"]);
    says(&bare, 3, "W0390");
    assert!(String::from_utf8_lossy(&bare.stdout).contains("it has no test vectors"));
    for wrong in ["[alarm]\nstroke_mm = [295.0, 305.0]\n", "[device]\ngone_s = 60000\n"] {
        fs::write(at.join("service.toml"), wrong).unwrap();
        says(&dbbd(at, &["serve", "--check", "--config", "service.toml"]), 1, "E1501");
    }
    fs::create_dir(at.join("demo")).unwrap();
    fs::write(at.join("demo/job.toml"), "mine").unwrap();
    says(&dbbd(at, &["demo", "--out", "demo"]), 1, "E0181");
    assert_ne!(dbbd(at, &["krl", "plan/plan.csv", "--out", "krl"]).status.code(), Some(1));
    says(&dbbd(at, &["simulate", "--program", "krl/DBB_MAIN.src", "--save", "krl"]), 1, "E0180");
    let endless = ["acquire", "--port", "sim", "--out", "r", "--sync-every", "1e9"];
    assert_eq!(dbbd(at, &endless).status.code(), Some(2));
}

#[test]
fn robots_frames_and_rows_in_other_units() {
    let (dir, data) = cell();
    let at = dir.path();
    let sound = crate::cell::KR60HA;
    for (from, to) in [
        ("angle_deg = 0.05", "angle_deg = 0.000873"),
        ("length_mm = 0.5", "length_mm = 0.0005"),
        ("repeatability_mm = 0.05", "repeatability_mm = 0.00005"),
        ("ball_mm = [30.0, 20.0, 10.0]", "ball_mm = [0.03, 0.02, 0.01]"),
    ] {
        let bad = sound.replacen(from, to, 1);
        assert_ne!(bad, sound, "{from}");
        fs::write(at.join("bad.toml"), bad).unwrap();
        says(&dbbd(at, &["robots", "check", "bad.toml"]), 1, "E0130");
    }
    let header = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n";
    let rows = data.rows.iter().take(12).enumerate().map(|(at, row)| {
        let deg = row.axes.degrees().map(|deg| if at == 4 { deg.to_radians() } else { deg });
        deg.map(|deg| deg.to_string()).join(",") + "\n"
    });
    fs::write(at.join("mixed.csv"), header.to_owned() + &rows.collect::<String>()).unwrap();
    says(
        &dbbd(at, &["predict", "mixed.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", "p.csv"]),
        3,
        "W1281",
    );
    assert_eq!(identify(at, &data.to_csv(), &PRIOR).status.code(), Some(0));
    let program = "DEF P()\n$TOOL={X 0.03,Y 0.0,Z 0.15,A 0.0,B 0.0,C 0.0}\n$BASE=$NULLFRAME\nPTP XP1\nEND\n";
    let points = "DEFDAT P\nDECL E6POS XP1={X 1300.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0,S 2,T 10}\nENDDAT\n";
    fs::write(at.join("P.src"), program).unwrap();
    fs::write(at.join("P.dat"), points).unwrap();
    let robot = "out/robot-identified.toml";
    says(&dbbd(at, &["compensate", "--replace", "P.src", "--robot", robot, "--out", "new"]), 1, "E0915");
    let tenths: Vec<String> = data.rows.iter().map(|row| format!("{:.1}", row.length_mm)).collect();
    let mut rounded = data.clone();
    rounded.rows.iter_mut().zip(tenths).for_each(|(row, tenth)| row.length_mm = tenth.parse().unwrap());
    let output = identify(at, &rounded.to_csv(), &PRIOR);
    assert!(codes(&output).contains(&"I1284".to_owned()), "{}", stderr(&output));
}
