//! Mistakes that users make, through the binary: each is refused, or reported with a warning with exit code 3.

use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd_model::measurement::Measurements;
use dbbd_model::robot::Robot;
use tempfile::{TempDir, tempdir};

use crate::cell::{centres_csv, codes, dbbd, kr60, measure, stderr, three_planes, with_errors};

/// The errors of the robot in rad and mm: some tenths of a millimetre at the ball.
pub(crate) const ERRORS: [(&str, f64); 4] =
    [("alpha1", 0.001), ("theta2", 0.0008), ("a2", 0.3), ("d4", -0.2)];
pub(crate) const JOB: &str = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\nlength_u_mm = 0.002\ntemperature_c = 20.0\n\
                   expansion_per_k = 12e-6\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 3\n\
                   arc_deg = 10.0\norientation = \"fixed\"\ntilt_deg = 30.0\n[motion]\nfeed_mm_s = 40.0\nsettle_s = 0.2\ndwell_s = 0.4\n\
                   [[obstacle]]\nshape = \"box\"\nlow_mm = [0.0, 900.0, 0.0]\nhigh_mm = [400.0, 1500.0, 1000.0]\n";

pub(crate) fn cell() -> (TempDir, Measurements) {
    let dir = tempdir().unwrap();
    let circles = three_planes(1, [1300.0, 0.0, 800.0]);
    let mut data = measure(&with_errors(ERRORS), &circles, 20, 20.0);
    for (at, row) in data.rows.iter_mut().enumerate() {
        // The repeatability of the robot, some hundredths of a millimetre, without random numbers.
        row.length_mm += 0.015 * (7.7 * at as f64).sin();
        row.sigma_mm = Some(0.002);
    }
    fs::write(dir.path().join("C.csv"), centres_csv(&circles)).unwrap();
    fs::write(dir.path().join("obs.csv"), data.to_csv()).unwrap();
    fs::write(dir.path().join("job.toml"), JOB).unwrap();
    (dir, data)
}

/// The exit code and the codes that were printed.
fn ended(output: &Output) -> (Option<i32>, Vec<String>) {
    (output.status.code(), codes(output))
}

pub(crate) fn says(output: &Output, exit: i32, code: &str) {
    let (ended, said) = ended(output);
    assert!(
        ended == Some(exit) && said.iter().any(|one| one == code),
        "{code}: {ended:?} {}",
        stderr(output)
    );
}

pub(crate) fn identify(dir: &Path, table: &str, more: &[&str]) -> Output {
    fs::write(dir.join("bad.csv"), table).unwrap();
    let given = ["identify", "bad.csv", "--centres", "C.csv", "--out", "out", "--folds", "0"];
    let robot = if more.contains(&"--robot") { &[][..] } else { &["--robot", "kr60ha"] };
    // A robot file has its tool.
    let is_file = more.windows(2).any(|pair| pair[0] == "--robot" && pair[1].ends_with(".toml"));
    let is_stated = more.contains(&"--tool") || is_file;
    let tool = if is_stated { &[][..] } else { &["--tool", "30,20,10"] };
    dbbd(dir, &[&given[..], robot, tool, more].concat())
}

#[test]
fn tables_of_lengths() {
    let (dir, data) = cell();
    let identified = |table: &Measurements, more: &[&str]| identify(dir.path(), &table.to_csv(), more);
    let prior = ["--prior", "datasheet"];
    let sound = identified(&data, &prior);
    assert!(
        sound.status.code() == Some(0) && !codes(&sound).iter().any(|code| code.starts_with('W')),
        "{}",
        stderr(&sound)
    );
    let changed = |change: &dyn Fn(&mut Measurements)| {
        let mut table = data.clone();
        change(&mut table);
        table
    };
    let sorted = changed(&|table| {
        let mut lengths: Vec<f64> = table.rows.iter().map(|row| row.length_mm).collect();
        lengths.sort_by(f64::total_cmp);
        table.rows.iter_mut().zip(lengths).for_each(|(row, length_mm)| row.length_mm = length_mm);
    });
    says(&identified(&sorted, &prior), 3, "W1333");
    let two_bars = changed(&|table| table.rows.iter_mut().skip(30).for_each(|row| row.length_mm += 0.4));
    says(&identified(&two_bars, &prior), 3, "W1333");
    let commanded = changed(&|table| table.rows.iter_mut().for_each(|row| row.length_mm = 300.0));
    says(&identified(&commanded, &prior), 3, "W1327");
    let other = measure(
        &with_errors([("alpha1", -0.002), ("a2", -0.8)]),
        &three_planes(1, [1300.0, 0.0, 800.0]),
        8,
        20.0,
    );
    fs::write(dir.path().join("other.csv"), other.to_csv()).unwrap();
    says(&identified(&data, &[&prior[..], &["--validate", "other.csv"]].concat()), 3, "W1382");
    says(&identified(&changed(&|table| table.rows[5].sigma_mm = None), &prior), 3, "W1280");
    says(&identified(&changed(&|table| table.rows[7].length_mm /= 25.4), &prior), 3, "W1282");
    // 20 degrees Celsius in Fahrenheit.
    let (header, rows) = data.to_csv().split_once('\n').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
    let rows: String = rows.lines().map(|row| format!("{row},68.0\n")).collect();
    let warm = identify(dir.path(), &format!("{header},temp_c\n{rows}"), &prior);
    says(&warm, 3, "W0131");
    // The file states the ball to 0.5 mm: 20 times that is too far. Two coordinates were exchanged, or the holder is another one.
    for tool in ["130,20,10", "10,20,30", "30,20,21"] {
        says(&identified(&data, &[&prior[..], &["--tool", tool]].concat()), 3, "W1312");
    }
    let near = identified(&data, &[&prior[..], &["--tool", "30,20,19"]].concat());
    assert!(!codes(&near).contains(&"W1312".to_owned()), "{}", stderr(&near));
    let narrow = Robot { limits_deg: [[-20.0, 20.0]; 6], ..kr60() };
    fs::write(dir.path().join("narrow.toml"), narrow.to_toml().unwrap()).unwrap();
    says(&identified(&data, &[&prior[..], &["--robot", "narrow.toml"]].concat()), 3, "W1281");
    let far = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg\n500,-60,90,0,60,0\n";
    fs::write(dir.path().join("far.csv"), far).unwrap();
    says(
        &dbbd(
            dir.path(),
            &["predict", "far.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", "p.csv"],
        ),
        3,
        "W1281",
    );
    let radians: String = data.rows.iter().fold(far.lines().next().unwrap().to_owned(), |table, row| {
        let angles = row.axes.degrees().map(|deg| deg.to_radians().to_string());
        format!("{table}\n{}", angles.join(","))
    });
    fs::write(dir.path().join("rad.csv"), radians).unwrap();
    says(
        &dbbd(
            dir.path(),
            &["predict", "rad.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", "p.csv"],
        ),
        3,
        "W1281",
    );
    let without_tool = ["predict", "far.csv", "--robot", "kr60ha", "--out", "p.csv"];
    says(&dbbd(dir.path(), &without_tool), 1, "E0507");
    let to_dash = ["predict", "far.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--out", "-"];
    says(&dbbd(dir.path(), &to_dash), 1, "E0102");
    for (options, exit, code) in [
        (&["--folds", "1"][..], 2, ""),
        (&["--bar-u", "1"], 2, ""),
        (&["--bar-u", "-0.001"], 2, ""),
        (&["--workspace", "far.csv"], 1, "E1301"),
    ] {
        let output = identified(&data, options);
        let one = options[0] == "--folds" || output.status.code() == Some(exit);
        assert!(
            one && (code.is_empty() || codes(&output).contains(&code.to_owned())),
            "{options:?} {}",
            stderr(&output)
        );
    }
    let once = [
        "identify",
        "obs.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
        "C.csv",
        "--out",
        "out",
        "--folds",
        "1",
    ];
    says(&dbbd(dir.path(), &once), 1, "E1301");
}

/// Values of a job that are in another unit, or that no plan can use.
const JOBS: &[(&str, &str, &str)] = &[
    ("length_u_mm = 0.002", "length_u_mm = 2.0", "E0130"),
    ("temperature_c = 20.0", "temperature_c = 68.0", "E0130"),
    ("expansion_per_k = 12e-6", "expansion_per_k = -12e-6", "E0130"),
    ("feed_mm_s = 40.0", "feed_mm_s = 0.04", "E0130"),
    ("feed_mm_s = 40.0", "feed_mm_s = 40.0\nturn_deg_s = 4000.0", "E0130"),
    ("dwell_s = 0.4", "dwell_s = 0.001", "E0130"),
    ("arc_deg = 10.0", "arc_deg = 6.283", "E0130"),
    ("high_mm = [400.0, 1500.0, 1000.0]", "high_mm = [0.4, 900.6, 1.0]", "E0130"),
    ("points = 3", "points = -3", "E0120"),
];

/// Robot files in radians or grams, and without a name.
const ROBOTS: &[(&str, &str, &str)] = &[
    ("theta_offset_deg = 0.0", "theta_offset_deg = 1.5708", "E0130"),
    ("limits_deg = [-185.0, 185.0]", "limits_deg = [-3.2, 3.2]", "E0130"),
    ("max_speed_deg_s = 128.0", "max_speed_deg_s = 2.23", "E0130"),
    ("name = \"KUKA KR 60 HA\"", "name = \"\"", "E0505"),
    ("repeatability_mm = 0.05", "repeatability_mm = 50.0", "E0130"),
];

#[test]
fn jobs_and_robots() {
    let (dir, _) = cell();
    for (from, to, code) in JOBS {
        let bad = JOB.replacen(from, to, 1);
        assert_ne!(bad, JOB, "{from}");
        fs::write(dir.path().join("bad.toml"), bad).unwrap();
        says(&dbbd(dir.path(), &["plan", "bad.toml", "--out", "plan"]), 1, code);
    }
    let sound = crate::cell::KR60HA;
    for (from, to, code) in ROBOTS {
        let bad = sound.replacen(from, to, 1);
        assert_ne!(bad, sound, "{from}");
        fs::write(dir.path().join("bad.toml"), bad).unwrap();
        says(&dbbd(dir.path(), &["robots", "check", "bad.toml"]), 1, code);
    }
}

#[test]
fn plans_programs_and_traces() {
    let (dir, _) = cell();
    let at = dir.path();
    let planned = dbbd(at, &["plan", "job.toml", "--out", "plan"]);
    assert_eq!(planned.status.code(), Some(0), "{}", stderr(&planned));
    // The same poses for another bar: the two files belong to different plans.
    fs::write(at.join("other.toml"), JOB.replace("[-6.0, 6.0]", "[-5.0, 5.0]")).unwrap();
    let other = dbbd(at, &["plan", "other.toml", "--out", "mixed"]);
    assert_eq!(other.status.code(), Some(0), "{}", stderr(&other));
    assert_eq!(fs::read(at.join("plan/plan.csv")).unwrap(), fs::read(at.join("mixed/plan.csv")).unwrap());
    let hash = |plan: &str| {
        let header: serde_json::Value =
            serde_json::from_slice(&fs::read(at.join(plan).join("plan.json")).unwrap()).unwrap();
        header["hash"].as_str().unwrap().to_owned()
    };
    assert_ne!(hash("plan"), hash("mixed"));
    let edited = fs::read_to_string(at.join("mixed/plan.json"))
        .unwrap()
        .replace("\"dwell_s\": 0.4", "\"dwell_s\": 50.0");
    fs::write(at.join("mixed/plan.json"), edited).unwrap();
    says(&dbbd(at, &["krl", "mixed/plan.csv", "--out", "krl"]), 1, "E0730");

    // Saved by a German spreadsheet.
    let german = fs::read_to_string(at.join("plan/plan.csv")).unwrap().replace(',', ";").replace('.', ",");
    fs::write(at.join("mixed/plan.csv"), german).unwrap();
    says(&dbbd(at, &["krl", "mixed/plan.csv", "--out", "krl"]), 1, "E0731");

    let krl =
        |more: &[&str]| dbbd(at, &[&["krl", "--replace", "plan/plan.csv", "--out", "krl"], more].concat());
    says(&krl(&["--server", "10.0.0.1:54600"]), 1, "E0880");
    says(&krl(&["--sync", "ekrl", "--server", "10.0.0.1:0"]), 1, "E0880");
    for nobody in ["0.0.0.0:54600", "255.255.255.255:54600", "239.0.0.1:54600"] {
        says(&krl(&["--sync", "ekrl", "--server", nobody]), 1, "E0880");
    }
    says(&krl(&["--sync", "ekrl", "--server", "127.0.0.1:54600"]), 0, "I0881");
    fs::write(at.join("krl/DBB_C002.src"), "").unwrap();
    says(&krl(&[]), 3, "W0882");

    // 20 readings per second over more than the plan's duration, with errors.
    let import = |name: &str, seconds: u32, reading: &dyn Fn(u32) -> f64, keep: &dyn Fn(u32) -> bool| {
        let rows = (0..20 * seconds).filter(|at| keep(*at));
        let rows = rows.map(|at| format!("{},{}\n", f64::from(at) / 20.0, reading(at)));
        fs::write(at.join(name), format!("t_s,length_mm\n{}", rows.collect::<String>())).unwrap();
        let _ = fs::remove_file(at.join("run"));
        dbbd(at, &["import", name, "--plan", "plan/plan.csv", "--out", "run"])
    };
    let still = |at: u32| 300.0 + 0.001 * f64::from(at % 7);
    assert_eq!(import("good.csv", 60, &still, &|_| true).status.code(), Some(0));
    says(&import("inch.csv", 60, &|at| still(at) / 25.4, &|_| true), 1, "E1180");
    says(&import("constant.csv", 60, &|_| 300.0, &|_| true), 3, "W1181");
    says(&import("slow.csv", 60, &still, &|at| at % 40 == 0), 3, "W1181");
    says(&import("hole.csv", 60, &still, &|at| !(200..300).contains(&at)), 3, "W1181");
    says(&import("short.csv", 5, &still, &|_| true), 3, "W1110");
    // A temperature in kelvin.
    let rows: String =
        (0..1200).map(|at| format!("{},{},293.1\n", f64::from(at) / 20.0, still(at))).collect();
    fs::write(at.join("kelvin.csv"), format!("t_s,length_mm,temp\n{rows}")).unwrap();
    fs::write(at.join("map.toml"), "[temperature]\ncolumn = \"temp\"\n").unwrap();
    let _ = fs::remove_file(at.join("run"));
    let kelvin = ["import", "kelvin.csv", "--mapping", "map.toml", "--plan", "plan/plan.csv", "--out", "run"];
    assert_eq!(dbbd(at, &kelvin).status.code(), Some(0));
    says(&dbbd(at, &["sync", "run", "--out", "o.csv"]), 1, "W0131");
    import("good.csv", 60, &still, &|_| true);
    says(&dbbd(at, &["sync", "run", "--axes", "krl/DBB_C001.dat", "--out", "o.csv"]), 1, "W0480");
    // A result does not replace the capture.
    let capture = fs::read(at.join("run")).unwrap();
    says(&dbbd(at, &["sync", "run", "--out", "run"]), 1, "E0180");
    assert_eq!(fs::read(at.join("run")).unwrap(), capture);
}

#[test]
fn corrections_and_circles() {
    let (dir, data) = cell();
    let at = dir.path();
    let identified = identify(at, &data.to_csv(), &["--prior", "datasheet"]);
    assert_eq!(identified.status.code(), Some(0), "{}", stderr(&identified));
    let program = "DEF P()\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\nPTP XP1\nEND\n";
    let points = "DEFDAT P\nDECL E6POS XP1={X 1300.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0,S 2,T 10}\nENDDAT\n";
    let compensate = |program: &str, points: &str, robot: &str| {
        fs::write(at.join("P.src"), program).unwrap();
        fs::write(at.join("P.dat"), points).unwrap();
        dbbd(at, &["compensate", "--replace", "P.src", "--robot", robot, "--out", "new"])
    };
    let robot = "out/robot-identified.toml";
    assert_eq!(compensate(program, points, robot).status.code(), Some(0));
    says(&compensate(&program.replace("END\n", ""), points, robot), 1, "E0980");
    says(&compensate(program, &points.replace("ENDDAT\n", ""), robot), 1, "E0980");
    says(&compensate(program, &points.replace("DEFDAT P", "DEFDAT Q"), robot), 1, "E0806");
    // Edited by hand: the posterior belongs to other values.
    let text = fs::read_to_string(at.join(robot)).unwrap();
    let line = text.lines().find(|line| line.starts_with("a_mm = 85")).unwrap();
    fs::write(at.join("edited.toml"), text.replacen(line, "a_mm = 851.5", 1)).unwrap();
    for output in [
        dbbd(at, &["robots", "check", "edited.toml"]),
        compensate(program, points, "edited.toml"),
        dbbd(at, &["predict", "obs.csv", "--robot", "edited.toml", "--out", "p.csv"]),
    ] {
        says(&output, 3, "W1332");
    }
    // Another name, another limit, another root of the covariance.
    let root =
        text.split("root = ").nth(1).unwrap().split(['[', ']', ',']).find(|word| word.contains('.')).unwrap();
    for (from, to) in [("name = \"KUKA", "name = \"KUKO"), ("-135.0", "-115.0"), (root, "0.5")] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from}");
        fs::write(at.join("edited.toml"), changed).unwrap();
        says(&dbbd(at, &["robots", "check", "edited.toml"]), 3, "W1840");
    }
    fs::write(at.join("frames.dat"), "DEFDAT CELL\nTOOL_DATA[1]={X 0,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n")
        .unwrap();
    compensate(program, points, robot);
    let config =
        ["compensate", "--replace", "P.src", "--robot", robot, "--out", "new", "--config", "frames.dat"];
    says(&dbbd(at, &config), 3, "W1841");

    let circle = |name: &str, length: &dyn Fn(u32) -> f64, more: &[&str]| {
        let rows = (0..72).map(|point| format!("1,ccw,{},{}\n", 5 * point, length(point)));
        fs::write(at.join(name), format!("run,direction,angle_deg,length_mm\n{}", rows.collect::<String>()))
            .unwrap();
        dbbd(at, &[&["circle", name, "--out", "q", "--monte-carlo", "0"], more].concat())
    };
    let round = |point: u32| 300.0 + 0.05 * (f64::from(point) * 0.17).sin();
    assert_eq!(circle("c.csv", &round, &["--radius", "300"]).status.code(), Some(0));
    says(&circle("c.csv", &round, &["--radius", "295"]), 3, "W1480");
    says(
        &circle(
            "spike.csv",
            &|point| round(point) + if point == 30 { 5.0 } else { 0.0 },
            &["--radius", "300"],
        ),
        3,
        "W1480",
    );
    says(&circle("equal.csv", &|_| 300.0, &["--radius", "300"]), 3, "W1480");
    says(&circle("c.csv", &round, &["--radius", "300", "c.csv"]), 3, "W1805");
    let rows = |name: &str, angle: &dyn Fn(u32) -> u32, more: &str, times: usize| {
        let rows = (0..72).map(|point| format!("1,ccw,{},{}{more}\n", angle(point), round(point)));
        let header = if more.is_empty() { "" } else { ",temp_c" };
        let rows = rows.collect::<String>().repeat(times);
        fs::write(at.join(name), format!("run,direction,angle_deg,length_mm{header}\n{rows}")).unwrap();
        dbbd(at, &["circle", name, "--out", "q", "--monte-carlo", "0", "--radius", "300"])
    };
    says(&rows("turns.csv", &|point| 50 * point, "", 1), 3, "W1482");
    says(&rows("twice.csv", &|point| 5 * point, "", 2), 3, "W1482");
    says(&rows("warm.csv", &|point| 5 * point, ",68.0", 1), 3, "W0131");
    says(&circle("c.csv", &round, &["--radius", "300", "--plan", "plan.csv"]), 1, "E1481");
    for wrong in [["--sigma", "2"], ["--certified", "293.15"]] {
        assert_eq!(circle("c.csv", &round, &wrong).status.code(), Some(2));
    }
}

#[test]
fn file_sets_are_replaced_together() {
    let (dir, data) = cell();
    let at = dir.path();
    let identified =
        |more: &[&str]| identify(at, &data.to_csv(), &[&["--prior", "datasheet"], more].concat());
    assert_eq!(identified(&[]).status.code(), Some(0));
    let files = || -> std::collections::BTreeMap<String, Vec<u8>> {
        let paths = fs::read_dir(at.join("out")).unwrap().map(|entry| entry.unwrap().path());
        let files = paths.filter(|path| path.is_file());
        files.map(|path| (path.display().to_string(), fs::read(&path).unwrap())).collect()
    };
    for taken in ["covariance.csv", "report.html", "lengths.csv"] {
        let before = fs::read(at.join("out").join(taken)).unwrap();
        fs::remove_file(at.join("out").join(taken)).unwrap();
        fs::create_dir(at.join("out").join(taken)).unwrap();
        let earlier = files();
        says(&identified(&["--sigma", "0.01"]), 1, "E0102");
        assert!(files() == earlier, "{taken}");
        fs::remove_dir(at.join("out").join(taken)).unwrap();
        fs::write(at.join("out").join(taken), before).unwrap();
    }
    let earlier = files();
    assert_ne!(identified(&["--sigma", "0.01"]).status.code(), Some(1));
    let new = files();
    assert!(earlier.keys().eq(new.keys()) && earlier != new);
}

#[test]
fn dates_balls_and_directories() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::create_dir(at.join("plans")).unwrap();
    fs::write(at.join("file"), "").unwrap();
    let wrong = [
        ("[identity]\nmeasured = \"2399-01-01\"\n", "E0680"),
        ("[identity.bar]\ncertified_on = \"2399-01-01\"\n", "E0680"),
        ("[identity.balls]\nleft = \"S-1\"\n", "E0680"),
        ("[identity.balls]\n1 = \"S-1\"\n2 = \"S-1\"\n", "E0680"),
        ("data = \"file\"\n", "E1501"),
        ("plans = \"file\"\n", "E1501"),
        ("plans = \"nowhere\"\n", "E1501"),
        ("data = \"plans\"\nplans = \"plans\"\n", "E1501"),
        ("[alarm]\nshare = 0.0\n", "E1501"),
        ("[alarm]\nstroke_mm = [-5000.0, 5000.0]\n", "E1501"),
    ];
    for (text, code) in wrong {
        fs::write(at.join("service.toml"), text).unwrap();
        says(&dbbd(at, &["serve", "--check", "--config", "service.toml"]), 1, code);
    }
    fs::write(at.join("service.toml"), "plans = \"plans\"\n").unwrap();
    assert_eq!(ended(&dbbd(at, &["serve", "--check", "--config", "service.toml"])).0, Some(0));
}
