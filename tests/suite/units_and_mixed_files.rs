//! Values in another unit, and files that do not belong together, are refused, or have a warning with a code and exit code 3.

use std::fs;
use std::path::Path;

use dbbd_model::robot::Robot;

use crate::cell::named;
use crate::cell::{codes, dbbd, stderr};
use crate::nothing_wrong_is_silent::{JOB, cell, identify, says};

#[test]
fn priors_and_frozen_bars() {
    let (dir, data) = cell();
    let at = dir.path();
    for sd in ["alpha1,rad,0.05", "a2,mm,500"] {
        fs::write(at.join("prior.csv"), format!("name,unit,sd\n{sd}\n")).unwrap();
        says(&identify(at, &data.to_csv(), &["--prior", "prior.csv"]), 1, "E0130");
    }
    fs::write(at.join("prior.csv"), "name,unit,sd\nalpha1,rad,0.0009\na2,mm,0.5\n").unwrap();
    assert_ne!(identify(at, &data.to_csv(), &["--prior", "prior.csv"]).status.code(), Some(1));
    let frozen = |rows: std::ops::Range<usize>| {
        let mut table = data.clone();
        let length_mm = table.rows[rows.start].length_mm;
        table.rows[rows].iter_mut().for_each(|row| row.length_mm = length_mm);
        table.to_csv()
    };
    says(&identify(at, &frozen(10..20), &["--prior", "datasheet"]), 3, "W1283");
    fs::write(at.join("equal.csv"), frozen(0..data.rows.len())).unwrap();
    says(&dbbd(at, &["plan", "job.toml", "--measured", "equal.csv", "--out", "plan"]), 3, "W1283");
}

#[test]
fn base_frames_and_floors_of_jobs() {
    let (dir, _) = cell();
    let at = dir.path();
    for motion in [
        "base = [100.0, 0.0, 50.0, 1.5708, 0.0, 0.0]",
        "tool = [30.0, 20.0, 10.0, 0.0, 0.7854, 0.0]",
        "base = [1.2, 0.1, 0.5, 0.0, 0.0, 0.0]",
    ] {
        fs::write(at.join("bad.toml"), JOB.replace("[motion]\n", &format!("[motion]\n{motion}\n"))).unwrap();
        says(&dbbd(at, &["plan", "bad.toml", "--out", "plan"]), 1, "E0130");
    }
    fs::write(at.join("bad.toml"), format!("{JOB}[[obstacle]]\nshape = \"floor\"\nz_mm = -0.4\n")).unwrap();
    says(&dbbd(at, &["plan", "bad.toml", "--out", "plan"]), 1, "E0130");
}

#[test]
fn sigmas_in_micrometres() {
    let (dir, mut data) = cell();
    let at = dir.path();
    for (sigma_mm, code) in [(2.0, "W0131"), (2e-6, "W0131"), (0.5, "W1335")] {
        data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(sigma_mm));
        says(&identify(at, &data.to_csv(), &["--prior", "datasheet"]), 3, code);
    }
    says(&identify(at, &data.to_csv(), &["--sigma", "2"]), 3, "W1335");
    fs::write(at.join("bad.toml"), JOB.replace("length_mm", "sigma_um = 0.002\nlength_mm")).unwrap();
    says(&dbbd(at, &["plan", "bad.toml", "--out", "plan"]), 1, "E0130");
}

#[test]
fn obstacles_in_the_robot_and_short_dwells() {
    let (dir, _) = cell();
    let at = dir.path();
    let plan = |job: String| {
        fs::write(at.join("job.toml"), job).unwrap();
        dbbd(at, &["plan", "job.toml", "--out", "plan"])
    };
    let with = |obstacle: &str| plan(format!("{JOB}[[obstacle]]\n{obstacle}\n"));
    for obstacle in [
        "shape = \"box\"\nlow_mm = [-300.0, -300.0, 0.0]\nhigh_mm = [300.0, 300.0, 500.0]",
        "shape = \"floor\"\nz_mm = 300.0",
    ] {
        says(&with(obstacle), 3, "W0682");
    }
    // A pedestal, and the plate that the robot's foot stands in.
    let pedestal = "shape = \"box\"\nlow_mm = [-300.0, -300.0, -800.0]\nhigh_mm = [300.0, 300.0, 30.0]";
    assert_eq!(with(pedestal).status.code(), Some(0));
    let polled = |dwell: &str| {
        let job = JOB.replace("dwell_s = 0.4", dwell);
        plan(job.replace("length_mm", "protocol = \"mitutoyo-idh\"\nlength_mm"))
    };
    assert_eq!(polled("dwell_s = 0.4").status.code(), Some(0));
    says(&polled("dwell_s = 0.2"), 3, "W0683");
}

/// Points of a program in metres, or of a robot on a rail.
#[test]
fn programs_in_metres_and_on_rails() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    let fixture = |name: &str| {
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/krl").join(name)).unwrap()
    };
    let identified = |robot: &str| {
        let robot = named(robot);
        let known = Robot { nominal: Some(Box::new(robot.clone())), ..robot };
        fs::write(at.join("id.toml"), known.to_toml().unwrap()).unwrap();
    };
    let corrected = |program: &str, more: &[&str]| {
        dbbd(
            at,
            &[&["compensate", "--replace", program, "--robot", "id.toml", "--out", "new"], more].concat(),
        )
    };
    for name in ["GLUE01.src", "GLUE01.dat", "config.dat"] {
        fs::write(at.join(name), fixture(name)).unwrap();
    }
    identified("kr60ha");
    let krl = |data: String| {
        fs::write(at.join("GLUE01.dat"), data).unwrap();
        corrected("GLUE01.src", &["--config", "config.dat"])
    };
    let sound = krl(fixture("GLUE01.dat"));
    assert!(!codes(&sound).contains(&"W0916".to_owned()), "{}", stderr(&sound));
    let rail = fixture("GLUE01.dat").replacen("S 2,T 11,E1 0.0", "S 2,T 11,E1 500.0", 1);
    says(&krl(rail), 3, "W0916");
    // A rail that stands still elsewhere is away from 0 as well.
    says(&krl(fixture("GLUE01.dat").replace("E1 0.0", "E1 400.0")), 3, "W0916");
    let coordinate = |part: &str| -> String {
        match part.split_once(['X', 'Y', 'Z']).and_then(|(_, mm)| mm.trim().parse::<f64>().ok()) {
            Some(mm) if part.len() < 16 => part.replace(&mm.to_string(), &(mm / 1e3).to_string()),
            _ => part.to_owned(),
        }
    };
    let lines = fixture("GLUE01.dat");
    let metres = lines.split(',').map(|part| match part.split_once('{') {
        Some((head, x)) if x.starts_with("X ") => format!("{head}{{{}", coordinate(x)),
        _ => coordinate(part),
    });
    says(&krl(metres.collect::<Vec<_>>().join(",")), 1, "E0915");
    says(&corrected("GLUE01.src", &["--config", "config.dat", "--limit", "5000"]), 1, "E0130");
    identified("irb1600-10-145");
    let module = "MODULE A\nCONST jointtarget p1 := [[0,0,0,0,30,0],[0,9E9,9E9,9E9,9E9,9E9]];\n\
        CONST jointtarget p2 := [[10,0,0,0,30,0],[500,9E9,9E9,9E9,9E9,9E9]];\n\
        PROC main()\nMoveAbsJ p1,v100,fine,tool0;\nMoveAbsJ p2,v100,fine,tool0;\nENDPROC\nENDMODULE\n";
    fs::write(at.join("A.mod"), module).unwrap();
    says(&corrected("A.mod", &[]), 3, "W0916");
    fs::write(at.join("A.mod"), module.replace("[500,", "[0,")).unwrap();
    assert_eq!(corrected("A.mod", &[]).status.code(), Some(0));
}

/// A circle of 72 points. Each line has angle, length, time and temperature.
fn circle(at: &Path, name: &str, line: &dyn Fn(u32) -> [f64; 4]) -> std::process::Output {
    let rows = (0..72).map(|point| {
        let [angle, length, t_s, temp_c] = line(point);
        format!("1,ccw,{angle},{length},{t_s},{temp_c}\n")
    });
    let rows = rows.collect::<String>();
    fs::write(at.join(name), format!("run,direction,angle_deg,length_mm,t_s,temp_c\n{rows}")).unwrap();
    let out = name.trim_end_matches(".csv");
    dbbd(at, &["circle", name, "--out", out, "--monte-carlo", "0", "--radius", "300"])
}

#[test]
fn angles_times_and_temperatures_of_circles() {
    let (dir, _) = cell();
    let at = dir.path();
    let sound = |point: u32| {
        let point = f64::from(point);
        [5.0 * point, 300.0 + 0.05 * (0.17 * point).sin(), point, 20.0 + 0.01 * point]
    };
    let changed = |column: usize, value: &dyn Fn(u32) -> f64, name: &str| {
        let line = |point: u32| {
            let mut line = sound(point);
            line[column] = value(point);
            line
        };
        circle(at, name, &line)
    };
    assert_eq!(circle(at, "first.csv", &sound).status.code(), Some(0));
    says(&changed(0, &|point| f64::from(point + 1), "counted.csv"), 3, "W1482");
    says(&changed(0, &|point| f64::from(point) * 400.0 / 72.0, "gon.csv"), 3, "W1482");
    says(&changed(2, &|point| f64::from(point % 40), "back.csv"), 3, "W1482");
    says(&changed(3, &|point| 20.0 + 0.3 * f64::from(point), "warmed.csv"), 3, "W1482");
    // Evaluated twice, and an arc beside a circle.
    assert_eq!(
        dbbd(
            at,
            &[
                "circle",
                "first.csv",
                "--out",
                "again",
                "--monte-carlo",
                "0",
                "--radius",
                "300",
                "--sigma",
                "0.001"
            ]
        )
        .status
        .code(),
        Some(0)
    );
    says(&dbbd(at, &["compare", "first", "again", "--out", "compared"]), 3, "W1908");
    let arc = changed(0, &|point| 2.5 * f64::from(point), "arc.csv");
    assert_eq!(arc.status.code(), Some(0), "{}", stderr(&arc));
    says(&dbbd(at, &["compare", "first", "arc", "--out", "compared"]), 3, "W1908");
}

#[test]
fn results_of_another_calibration() {
    let (dir, data) = cell();
    let at = dir.path();
    let given = ["--prior", "datasheet"];
    assert_eq!(identify(at, &data.to_csv(), &given).status.code(), Some(0));
    fs::rename(at.join("out"), at.join("first")).unwrap();
    let mut half = data.clone();
    half.rows.truncate(40);
    assert_ne!(identify(at, &half.to_csv(), &given).status.code(), Some(1));
    let check = || {
        let robot = "first/robot-identified.toml";
        dbbd(at, &["check", "obs.csv", "--robot", robot, "--centres", "C.csv", "--out", "checked"])
    };
    let sound = check();
    assert!(!codes(&sound).contains(&"W1922".to_owned()), "{}", stderr(&sound));
    fs::copy(at.join("out/result.json"), at.join("first/result.json")).unwrap();
    says(&check(), 3, "W1922");
}

#[test]
fn checks_of_another_robot() {
    let (dir, data) = cell();
    let at = dir.path();
    let check = |name: &str, serial: &str| {
        let robot = Robot { name: name.into(), serial: Some(serial.into()), ..named("kr60ha") };
        fs::write(at.join("own.toml"), robot.to_toml().unwrap()).unwrap();
        let identified = identify(at, &data.to_csv(), &["--robot", "own.toml", "--prior", "datasheet"]);
        assert_eq!(identified.status.code(), Some(0), "{}", stderr(&identified));
        let robot = at.join(format!("{serial}.toml"));
        fs::rename(at.join("out/robot-identified.toml"), &robot).unwrap();
        fs::remove_dir_all(at.join("out")).unwrap();
        let robot = robot.display().to_string();
        dbbd(at, &["check", "obs.csv", "--robot", &robot, "--centres", "C.csv", "--out", "checked"])
    };
    assert_ne!(check("KUKA KR 60 HA", "A1").status.code(), Some(1));
    assert_ne!(check("KUKA KR 60 HA", "A1").status.code(), Some(1));
    says(&check("KUKA KR 60 HA", "B2"), 1, "E0181");
}

#[test]
fn exports_replace_only_exports() {
    let (dir, _) = cell();
    let at = dir.path();
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    let rows =
        (0..1200).map(|row| format!("{},{}\n", f64::from(row) / 20.0, 300.0 + 0.001 * f64::from(row % 7)));
    fs::write(at.join("t.csv"), format!("t_s,length_mm\n{}", rows.collect::<String>())).unwrap();
    assert_eq!(
        dbbd(at, &["import", "t.csv", "--plan", "plan/plan.csv", "--out", "run"]).status.code(),
        Some(0)
    );
    let export =
        |more: &[&str]| dbbd(at, &[&["export", "--replace", "run", "--out", "tables"], more].concat());
    for _ in 0..2 {
        assert_eq!(export(&[]).status.code(), Some(0));
        assert_eq!(export(&["--mcap"]).status.code(), Some(0));
    }
    for (file, more) in [("events.csv", &[][..]), ("run.mcap", &["--mcap"])] {
        fs::write(at.join("tables").join(file), "mine").unwrap();
        says(&export(more), 1, "E0181");
        assert_eq!(fs::read(at.join("tables").join(file)).unwrap(), b"mine");
    }
}
