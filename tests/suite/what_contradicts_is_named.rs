//! Contradictions in a run, in a table or between two files are refused, or have a warning with a code and exit code 3.
#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::process::Output;

use tempfile::{TempDir, tempdir};

use crate::cell::{codes, dbbd, stderr};
use crate::nothing_wrong_is_silent::{cell, identify, says};

const PRIOR: [&str; 2] = ["--prior", "datasheet"];
const JOB: &str = "robot = \"kr60ha\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-6.0, 6.0]\nlength_u_mm = 0.002\nexpansion_per_k = 12e-6\n\
    [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n\
    [[circle]]\nplane = \"XY\"\npoints = 6\narc_deg = 40.0\norientation = \"fixed\"\ntilt_deg = 30.0\n\
    [[circle]]\nplane = \"XY\"\npoints = 6\narc_deg = 40.0\norientation = \"fixed\"\ntilt_deg = 30.0\n\
    [motion]\nfeed_mm_s = 40.0\nsettle_s = 0.2\ndwell_s = 0.4\n";
const MAPPING: &str = "[time]\ncolumn = \"ticks\"\nunit = \"us\"\n[length]\ncolumn = \"reading_mm\"\nkind = \"reading\"\n\
    [strobe]\ncolumn = \"trigger\"\n[valid]\ncolumn = \"valid\"\n[temperature]\ncolumn = \"temperature_c\"\n";

/// The samples of a simulated run; columns can be changed.
struct Recorded {
    dir: TempDir,
    rows: Vec<Vec<String>>,
}

impl Recorded {
    fn new() -> Self {
        let dir = tempdir().unwrap();
        let at = dir.path();
        fs::write(at.join("job.toml"), JOB).unwrap();
        fs::write(at.join("m.toml"), MAPPING).unwrap();
        for args in [
            &["plan", "job.toml", "--out", "plan"][..],
            &["acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run.dbbd"],
            &["export", "run.dbbd", "--out", "csv"],
        ] {
            let output = dbbd(at, args);
            assert_eq!(output.status.code(), Some(0), "{args:?} {}", stderr(&output));
        }
        let text = fs::read_to_string(at.join("csv/samples.csv")).unwrap();
        let rows = text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        Self { dir, rows }
    }

    /// Runs `sync` with a column changed by a function of row number and value.
    fn with(&self, column: &str, value: impl Fn(usize, &str) -> String) -> Output {
        let (dir, place) = (tempdir().unwrap(), self.rows[0].iter().position(|name| name == column).unwrap());
        let changed = self.rows.iter().enumerate().map(|(at, row)| {
            let mut row = row.clone();
            if at > 0 {
                row[place] = value(at, &row[place]);
            }
            row.join(",") + "\n"
        });
        fs::write(dir.path().join("s.csv"), changed.collect::<String>()).unwrap();
        let own = |name: &str| self.dir.path().join(name).display().to_string();
        let (plan, mapping) = (own("plan/plan.csv"), own("m.toml"));
        let import = ["import", "s.csv", "--mapping", &mapping, "--plan", &plan, "--out", "r.dbbd"];
        assert_ne!(dbbd(dir.path(), &import).status.code(), Some(1));
        dbbd(dir.path(), &["sync", "r.dbbd", "--out", "o.csv"])
    }
}

fn times(factor: f64) -> impl Fn(usize, &str) -> String {
    move |_, reading| {
        reading.parse::<f64>().map_or(String::new(), |mm| (factor * mm).clamp(-6.0, 6.0).to_string())
    }
}

#[test]
fn sign_scale_and_temperature_of_a_run() {
    let run = Recorded::new();
    let sound = run.with("reading_mm", times(1.0));
    assert_eq!(sound.status.code(), Some(0), "{}", stderr(&sound));
    says(&run.with("reading_mm", times(-1.0)), 1, "E1082");
    for factor in [0.5, 2.0, 1.0 / 25.4] {
        says(&run.with("reading_mm", times(factor)), 3, "W1081");
    }
    // Half a second behind the strobe.
    let place = run.rows[0].iter().position(|name| name == "reading_mm").unwrap();
    let late = |at: usize, _: &str| run.rows[at.saturating_sub(100).max(1)][place].clone();
    says(&run.with("reading_mm", late), 3, "W1083");
    says(&run.with("temperature_c", |_, _| "0.0".into()), 3, "W0131");
    let loose = |at: usize, _: &str| if (at / 500).is_multiple_of(2) { "20.0".into() } else { "28.0".into() };
    says(&run.with("temperature_c", loose), 3, "W0481");
}

#[test]
fn unseated_bars() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    fs::write(at.join("job.toml"), JOB).unwrap();
    assert_eq!(dbbd(at, &["plan", "job.toml", "--out", "plan"]).status.code(), Some(0));
    let plan = "plan/plan.csv";
    assert_eq!(dbbd(at, &["krl", plan, "--out", "krl"]).status.code(), Some(0));
    let simulate = ["--program", "krl/DBB_MAIN.src", "--fault", "unseated_um=100", "--speed", "0"];
    let mut cell = std::process::Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args([&["simulate"][..], &simulate, &["--link", "bar", "--quiet"]].concat())
        .current_dir(at)
        .spawn()
        .unwrap();
    while !at.join("bar").exists() && cell.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let acquired = dbbd(at, &["acquire", "--port", "bar", "--plan", plan, "--out", "r.dbbd"]);
    let _ = cell.kill();
    let _ = cell.wait();
    assert_ne!(acquired.status.code(), Some(1), "{}", stderr(&acquired));
    for args in [&["sync", "r.dbbd", "--out", "o.csv"][..], &["info", "r.dbbd"]] {
        says(&dbbd(at, args), 3, "W0280");
    }
}

#[test]
fn lengths_of_another_bar() {
    let (dir, data) = cell();
    let at = dir.path();
    let longer = |mm: f64| {
        let mut table = data.clone();
        table.rows.iter_mut().for_each(|row| row.length_mm += mm);
        table.to_csv()
    };
    let plan = |table: String| {
        fs::write(at.join("m.csv"), table).unwrap();
        dbbd(at, &["plan", "job.toml", "--measured", "m.csv", "--out", "plan"])
    };
    says(&plan(longer(50.0)), 1, "E0721");
    says(&plan(longer(4.0)), 3, "W1312");
    let certified = [&PRIOR[..], &["--bar-u", "0.001"]].concat();
    says(&identify(at, &longer(4.0), &certified), 3, "W1312");
    let held = identify(at, &data.to_csv(), &[&PRIOR[..], &["--hold", "bar"]].concat());
    assert!(codes(&held).contains(&"I1341".to_owned()), "{}", stderr(&held));
    fs::write(at.join("C.csv"), "centre,x_mm,y_mm,z_mm\n1,1303,0,802\n").unwrap();
    says(&identify(at, &data.to_csv(), &[&PRIOR[..], &["--hold", "centres"]].concat()), 3, "W1312");
    let metres = ["identify", "m.csv", "--robot", "kr60ha", "--tool", "0.03,0.02,0.01", "--out", "r"];
    assert_eq!(dbbd(at, &metres).status.code(), Some(2));
}

#[test]
fn results_of_the_same_lengths() {
    let (dir, data) = cell();
    let at = dir.path();
    let run = |table: &str, out: &str, more: &[&str]| {
        let output = identify(at, table, &[&PRIOR[..], more].concat());
        assert_ne!(output.status.code(), Some(1), "{}", stderr(&output));
        fs::rename(at.join("out"), at.join(out)).unwrap();
    };
    run(&data.to_csv(), "first", &[]);
    run(&data.to_csv(), "again", &["--sigma", "0.003"]);
    says(&dbbd(at, &["compare", "first", "again", "--out", "c"]), 3, "W1805");
    let mut spoiled = data.clone();
    spoiled.rows.iter_mut().skip(30).for_each(|row| row.length_mm += 0.4);
    run(&spoiled.to_csv(), "spoiled", &[]);
    says(&dbbd(at, &["compare", "first", "spoiled", "--out", "c"]), 3, "W1843");
    // Saved by a spreadsheet: three decimals, and renumbered rows.
    let mut rounded = data.clone();
    for row in &mut rounded.rows {
        (row.index, row.length_mm) = (row.index + 100, (1e3 * row.length_mm).round() / 1e3);
    }
    let used = identify(at, &rounded.to_csv(), &["--robot", "first/robot-identified.toml"]);
    says(&used, 3, "W1334");
}

/// 72 points in both directions about the same centre; `length_mm` is added to a length, by direction (1, -1) and angle.
fn circle(at: &Path, more: &[&str], length_mm: &dyn Fn(f64, f64) -> f64) -> Output {
    let rows = [("1,ccw", 1.0), ("2,cw", -1.0)].into_iter().flat_map(|(run, sense)| {
        (0..72).map(move |point| {
            let deg = (sense * 5.0 * f64::from(point)).rem_euclid(360.0);
            let form = 0.02 * deg.to_radians().cos() + 0.0005 * (7.7 * f64::from(point) + sense).sin();
            (run, sense, deg, 150.0 + form)
        })
    });
    let rows = rows.map(|(run, sense, deg, mm)| format!("{run},{deg},{}\n", mm + length_mm(sense, deg)));
    fs::write(at.join("c.csv"), format!("run,direction,angle_deg,length_mm\n{}", rows.collect::<String>()))
        .unwrap();
    dbbd(at, &[&["circle", "c.csv", "--out", "q", "--monte-carlo", "0"], more].concat())
}

#[test]
fn impossible_circles() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let play = |sense: f64, deg: f64| 0.02 * sense * deg.to_radians().sin().signum();
    let sound = circle(at, &[], &play);
    assert_eq!(sound.status.code(), Some(0), "{}", stderr(&sound));
    let of_second = |sense: f64| if sense < 0.0 { 1.0 } else { 0.0 };
    says(&circle(at, &[], &|sense, _| 0.02 * of_second(sense)), 3, "W1480");
    says(&circle(at, &[], &|sense, deg| 0.05 * of_second(sense) * deg.to_radians().cos()), 3, "W1480");
    says(&circle(at, &[], &|_, deg| 9.0 * (2.0 * deg.to_radians()).cos()), 3, "W1480");
    says(&circle(at, &["--radius", "150.5"], &play), 3, "W1480");
    let text = fs::read_to_string(at.join("c.csv")).unwrap();
    let changed = |of: &dyn Fn(usize, &str) -> String| {
        let lines = text.lines().enumerate().map(|(at, line)| match line.rsplit_once(',') {
            Some((head, mm)) if at > 0 => format!("{head},{}\n", of(at, mm)),
            _ => format!("{line}\n"),
        });
        fs::write(at.join("c.csv"), lines.collect::<String>()).unwrap();
        dbbd(at, &["circle", "c.csv", "--out", "q", "--monte-carlo", "0"])
    };
    says(&changed(&|_, mm| format!("{:.2}", mm.parse::<f64>().unwrap())), 3, "W1480");
    let frozen = |at: usize, mm: &str| if (20..40).contains(&at) { "150.0012".into() } else { mm.to_owned() };
    says(&changed(&frozen), 3, "W1480");
    let deviations_um = |_: usize, mm: &str| (1e3 * (mm.parse::<f64>().unwrap() - 150.0)).to_string();
    says(&changed(&deviations_um), 1, "E0130");
    // The numbers of the points of both runs in place of the angles.
    let numbered = text.lines().enumerate().map(|(at, line)| match line.split(',').collect::<Vec<_>>()[..] {
        [run, direction, _, mm] if at > 0 => format!("{run},{direction},{},{mm}\n", (at - 1) % 72),
        _ => format!("{line}\n"),
    });
    fs::write(at.join("c.csv"), numbered.collect::<String>()).unwrap();
    says(&dbbd(at, &["circle", "c.csv", "--out", "q", "--monte-carlo", "0"]), 3, "W1482");
    // An arc that is passed to and fro in steps of a degree is sound.
    let arc = (0..72).map(|deg| ("1,ccw", deg)).chain((0..72).rev().map(|deg| ("2,cw", deg)));
    let arc = arc.map(|(run, deg)| {
        format!(
            "{run},{deg},{}\n",
            150.0 + 0.02 * f64::from(deg).to_radians().cos() + 0.0005 * (7.7 * f64::from(deg)).sin()
        )
    });
    fs::write(at.join("c.csv"), format!("run,direction,angle_deg,length_mm\n{}", arc.collect::<String>()))
        .unwrap();
    let arc = dbbd(at, &["circle", "c.csv", "--out", "q", "--monte-carlo", "0"]);
    assert!(!codes(&arc).contains(&"W1482".to_owned()), "{}", stderr(&arc));
}

#[test]
fn jobs_definitions_and_options() {
    let (dir, _) = cell();
    let at = dir.path();
    let job = |from: &str, to: &str, code: &str| {
        let text = JOB.replace(from, to);
        assert_ne!(text, JOB);
        fs::write(at.join("bad.toml"), text).unwrap();
        says(&dbbd(at, &["plan", "bad.toml", "--out", "plan"]), 1, code);
    };
    job("expansion_per_k = 12e-6", "expansion_per_k = 12e-5", "E0130");
    let second = "[[centre]]\nid = 2\nxyz_mm = [1300.0, 1.0, 800.0]\n[motion]";
    job("[motion]", second, "E0602");
    job("[motion]", "[identity]\nload_kg = 8000.0\n[motion]", "E0130");
    let own = include_str!("../../protocols/dbb-csv-1.toml").replacen("title = \"", "title = \"Own: ", 1);
    fs::write(at.join("own.toml"), own).unwrap();
    says(&dbbd(at, &["protocols", "check", "own.toml"]), 3, "W0391");
    let check =
        ["check", "obs.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--centres", "C.csv", "--out", "c"];
    for option in [&["--simple-acceptance"][..], &["--risk", "0.1"]] {
        assert_eq!(dbbd(at, &[&check[..], option].concat()).status.code(), Some(2));
    }
    fs::write(at.join("DBB.src"), "DEF DBB()\nEND\n").unwrap();
    let radians = ["compensate", "DBB.src", "--robot", "kr60ha", "--out", "x", "--tool", "1,0,2,0,1.5708,0"];
    assert_eq!(dbbd(at, &radians).status.code(), Some(2));
    fs::write(at.join("result.json"), "{ \"parameters\": ").unwrap();
    says(&dbbd(at, &["info", "result.json"]), 1, "E1807");
}

#[test]
fn runs_with_a_wrong_clock() {
    let run = Recorded::new();
    let at = run.dir.path();
    let ticks = run.rows[0].iter().position(|name| name == "ticks").unwrap();
    let dated = run.rows.iter().enumerate().map(|(row, cells)| {
        let mut cells = cells.clone();
        if row > 0 {
            let s = cells[ticks].parse::<f64>().unwrap() * 1e-6;
            cells[ticks] = format!("1975-03-01T10:{:02}:{:06.3}", (s / 60.0) as u32 % 60, s % 60.0);
        }
        cells.join(",") + "\n"
    });
    fs::write(at.join("s.csv"), dated.collect::<String>()).unwrap();
    fs::write(at.join("d.toml"), MAPPING.replace("unit = \"us\"", "unit = \"iso\"")).unwrap();
    let import = ["import", "s.csv", "--mapping", "d.toml", "--plan", "plan/plan.csv", "--out", "dated.dbbd"];
    assert_ne!(dbbd(at, &import).status.code(), Some(1), "{}", stderr(&dbbd(at, &import)));
    says(&dbbd(at, &["sync", "dated.dbbd", "--out", "o.csv"]), 3, "W0416");
}
