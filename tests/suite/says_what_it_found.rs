//! Every plain-language sentence of an identification has data that provoke it.
//!
//! The sentences are read out of the sources: each string literal there, and each text of the page, whose longest
//! fixed stretch is four words or more. A new sentence fails here until a scenario below provokes it.

use std::fs;
use std::path::Path;

use dbbd::model::pose::rot_x;
use dbbd::model::{Further, Observations, Robot};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tempfile::tempdir;

use crate::cell::{
    CENTRE, Circle, DESIGNED, centres_csv, dbbd, horizontal, kr60, measure, three_planes, with_errors,
};

/// Where sentences stand that a user reads of an identification.
const SOURCES: &[&str] = &[
    "src/identifiability/wording.rs",
    "src/identifiability/trial/candidates.rs",
    "src/identifiability/trial/words.rs",
    "src/identify/verdict.rs",
    "src/identify/summary.rs",
    "src/identify/estimate.rs",
    "src/identify/diagnosis.rs",
    "src/identify/monte_carlo.rs",
    "src/cli/identify/inputs.rs",
    "src/cli/identify/say.rs",
    "src/report/identification.rs",
    "src/report/identification.html",
    "src/report/diagnosis.rs",
    "src/report/handing_back.rs",
    "src/export/mastering.rs",
];

/// One run: what is measured, what is asked, and what comes out.
struct Scene {
    robot: String,
    circles: Vec<Circle>,
    data: Observations,
    args: Vec<&'static str>,
}

impl Scene {
    fn new(truth: &Robot, circles: &[Circle], points: usize, sigma_mm: f64, args: &[&'static str]) -> Self {
        let mut random = Pcg64::seed_from_u64(1);
        let mut data = measure(truth, circles, points, 25.0);
        for row in &mut data.rows {
            let z: f64 = StandardNormal.sample(&mut random);
            row.length_mm += sigma_mm * z;
        }
        Self { robot: kr60().to_toml(), circles: circles.to_vec(), data, args: args.to_vec() }
    }

    fn spoilt(mut self, every: usize, mm: f64) -> Self {
        self.data.rows.iter_mut().step_by(every).for_each(|row| row.length_mm += mm);
        self
    }

    /// All that the user can read: terminal, page, result and tables.
    fn told(&self) -> String {
        let dir = tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
        write("robot.toml", &self.robot);
        write("obs.csv", &self.data.to_csv());
        write("centres.csv", &centres_csv(&self.circles));
        write("headless.csv", "name,sd\na2,0.1\n");
        write("unit.csv", "name,unit,sd\na2,m,0.1\n");
        write("negative.csv", "name,unit,sd\na2,mm,-0.1\n");
        write("plan.csv", "move,dwell_s\nptp,0.5\n");
        let args =
            ["identify", "obs.csv", "--robot", "robot.toml", "--centres", "centres.csv", "--out", "out"];
        let output = dbbd(dir.path(), &[&args[..], &self.args[..]].concat());
        let mut told = format!(
            "{}\n{}",
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
        for name in ["report.html", "result.json", "mastering.csv", "DBB_RESULT.dat"] {
            told.push_str(&fs::read_to_string(dir.path().join("out").join(name)).unwrap_or_default());
        }
        told
    }
}

/// The data that provoke the sentences.
fn scenes() -> Vec<Scene> {
    let truth = with_errors(DESIGNED);
    let flat = [horizontal(1, CENTRE)];
    let planes = three_planes(1, CENTRE);
    let thirteen = ["--estimate", "alpha1-5,a1-5,d4-6", "--folds", "0"];
    let mut scenes = vec![
        // What a horizontal circle confounds; predicted worse than the nominal robot.
        Scene::new(&truth, &flat, 80, 0.0, &["--estimate", "alpha1-5,a1-5,d2-6"]),
        Scene::new(&truth, &flat, 80, 0.002, &["--sigma", "0.002"]),
        Scene::new(&truth, &flat, 80, 0.01, &["--prior", "datasheet"]),
        // Too weak; the user's own holding; a check file.
        Scene::new(&truth, &planes, 27, 0.02, &["--hold", "theta2", "--validate", "obs.csv"]),
        // Sigma given too small, too large, and too small in the file.
        Scene::new(&truth, &planes, 27, 0.05, &["--sigma", "0.005"]),
        Scene::new(&truth, &planes, 27, 0.005, &["--sigma", "0.05"]),
        Scene::new(&truth, &planes, 27, 0.01, &[]).spoilt(40, 5.0),
        // More outliers than one in ten; as many parameters as lengths.
        Scene::new(&truth, &planes, 27, 0.005, &["--prior", "datasheet"]).spoilt(8, 10.0),
        Scene::new(&truth, &flat, 13, 0.0, &thirteen),
        // Nothing moved by what is asked for; only the ball's place, which is fitted before as well.
        Scene::new(&truth, &planes, 27, 0.0, &["--estimate", "theta6", "--tool", "0,0,100"]),
        Scene::new(&truth, &planes, 27, 0.01, &["--estimate", "centres", "--folds", "0"]),
        // A tool ball on axis 6, held there; one held where it is not.
        Scene::new(&truth, &planes, 27, 0.01, &["--tool", "0,0,100", "--hold", "tool", "--folds", "0"]),
        Scene::new(&truth, &planes, 27, 0.01, &["--tool", "30,20,60", "--hold", "tool", "--folds", "0"]),
        // Arguments and priors that cannot be.
        Scene::new(&truth, &flat, 20, 0.0, &["--tool", "30,20"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--sigma", "-1"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior", "headless.csv"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior", "unit.csv"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior", "negative.csv"]),
        Scene::new(&truth, &flat, 20, 0.0, &["--prior-scale", "0"]),
        // A plan in place of measured lengths.
        Scene::new(&truth, &flat, 20, 0.0, &["--validate", "plan.csv"]),
        // A length that is none.
        Scene::new(&truth, &flat, 80, 0.0, &thirteen).spoilt(1, 1e200),
    ];
    // Two bars with an offset each; a prior whose strength is chosen, and lengths drawn anew.
    let mut two = Scene::new(&kr60(), &planes, 27, 0.0, &["--estimate", "all", "--folds", "0"]);
    two.data.rows.iter_mut().step_by(2).for_each(|row| row.bar = 2);
    scenes.push(two);
    let choices = ["--prior", "datasheet", "--prior-scale", "auto", "--monte-carlo", "100"];
    scenes.push(Scene::new(&truth, &planes, 20, 0.01, &choices));
    // As `dbbd sync` writes them: circles with angles, and a reference pose.
    let mut synced = Scene::new(&truth, &planes, 27, 0.01, &["--prior", "datasheet", "--hold", "centres"]);
    synced.data.further = Further::new(["kind", "circle", "angle_deg"]);
    for (at, row) in synced.data.rows.iter_mut().enumerate() {
        let kind = if at % 20 == 0 { "reference" } else { "measure" };
        let angle = 360.0 / 27.0 * (at % 27) as f64;
        row.further = synced.data.further.add([kind, &(1 + at / 27).to_string(), &angle.to_string()]);
    }
    scenes.push(synced);
    let mut given = Scene::new(&truth, &planes, 27, 0.05, &[]);
    given.data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.005));
    scenes.push(given);
    // One length more than directions: it alone cannot show that sigma is too small.
    let mut few = Scene::new(&truth, &planes, 9, 0.05, &["--prior", "datasheet"]);
    few.data.rows.truncate(25);
    few.data.rows.iter_mut().for_each(|row| row.sigma_mm = Some(0.015));
    scenes.push(few);
    // Balls and lengths that have nothing to do with each other.
    let mut lost = Scene::new(&truth, &flat, 80, 0.0, &thirteen);
    lost.circles = vec![horizontal(1, [0.0, 9000.0, 0.0])];
    scenes.push(lost);
    // A ball that stands elsewhere than was said.
    let mut astray = Scene::new(&truth, &planes, 27, 0.01, &["--estimate", "centres", "--folds", "0"]);
    astray.circles = vec![horizontal(1, [2500.0, 0.0, 800.0])];
    scenes.push(astray);
    // An arm that may hardly move from where it measured, so that no other pose can be tried.
    let mut narrow = Scene::new(&truth, &flat, 80, 0.02, &["--prior", "datasheet"]);
    let mut robot = kr60();
    for axis in 0..6 {
        let angles = || narrow.data.rows.iter().map(move |row| row.axes_deg[axis]);
        let (low, high) =
            (angles().fold(f64::INFINITY, f64::min), angles().fold(f64::NEG_INFINITY, f64::max));
        let middle = 0.5 * (low + high);
        robot.limits_deg[axis] = if axis < 3 { [middle - 0.01, middle + 0.01] } else { [low, high] };
    }
    narrow.robot = robot.to_toml();
    scenes.push(narrow);
    // Play at axis 3, and a gear's error at axis 2.
    let mut random = Pcg64::seed_from_u64(3);
    let mut worn = Scene::new(&truth, &planes, 60, 0.005, &["--hold", "bar_offset"]);
    for at in (1..worn.data.rows.len()).rev() {
        worn.data.rows.swap(at, random.random_range(0..=at));
    }
    let mut last = worn.data.rows[0].axes();
    for row in &mut worn.data.rows {
        let axes = row.axes();
        let (mut stands, before) = (axes, truth.geometry.length(&axes, &Vector3::from(CENTRE), 0.0));
        stands[1] += 0.5e-3 * (4.0 * axes[1]).sin() + 0.5e-3 * (2.0 * axes[1]).sin();
        stands[2] -= 0.2e-3 * (axes[2] - last[2]).signum();
        row.length_mm += truth.geometry.length(&stands, &Vector3::from(CENTRE), 0.0) - before;
        last = axes;
    }
    scenes.push(worn);
    // A robot far worse than its file says.
    let worse = with_errors([("a1", 6.0), ("a2", 5.0), ("a3", -4.0), ("d4", 4.0), ("theta3", 0.02)]);
    scenes.push(Scene::new(&worse, &planes, 27, 0.01, &["--prior", "datasheet"]));
    // Noise as large as a fifth of the bar, and ten bars large: lengths bend, and draws do not come to rest.
    for sigma in ["60", "100", "3000"] {
        let args = ["--estimate", "centres,tool", "--sigma", sigma, "--monte-carlo", "1000", "--folds", "0"];
        scenes.push(Scene::new(&truth, &planes, 5, 0.01, &args));
    }
    // A tool that never turns, start angles off by next to nothing; the same with a list that is followed.
    for args in [&[][..], &["--estimate", "tool,centres"][..]] {
        let mut still = Scene::new(&truth, &flat, 80, 0.0, args);
        still.data = measure(&truth, &flat, 80, 0.0);
        for (at, row) in still.data.rows.iter_mut().enumerate() {
            row.axes_deg
                .iter_mut()
                .enumerate()
                .for_each(|(k, a)| *a += 5e-7 * ((6 * at + k) as f64 * 78.233).sin());
        }
        scenes.push(still);
    }
    // One tilted circle, on which the wrist does not turn with the tool's own axis told.
    let tilted = [Circle { plane: rot_x(0.5), ..horizontal(1, CENTRE) }];
    scenes.push(Scene::new(&truth, &tilted, 40, 0.02, &["--prior", "datasheet", "--tool", "0,0,100"]));
    scenes
}

/// The string literals of Rust text, comments and the unit tests left out, lines joined as the compiler joins them.
fn literals(source: &str) -> Vec<String> {
    let code = source.split("#[cfg(test)]").next().unwrap();
    let lines: Vec<&str> = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let text = lines.join("\n");
    let (mut found, mut rest) = (Vec::new(), text.as_str());
    while let Some(start) = rest.find('"') {
        let (mut literal, mut letters) = (String::new(), rest[start + 1..].char_indices());
        let mut end = rest.len() - start - 1;
        let mut skipping = false;
        while let Some((at, letter)) = letters.next() {
            match letter {
                '"' => {
                    end = at + 1;
                    break;
                }
                '\\' => match letters.next() {
                    Some((_, '\n')) => skipping = true,
                    Some((_, other)) => literal.push(other),
                    None => {}
                },
                ' ' if skipping => {}
                _ => {
                    skipping = false;
                    literal.push(letter);
                }
            }
        }
        found.push(literal);
        rest = &rest[start + 1 + end..];
    }
    found
}

/// The texts between the tags and the expressions of a template.
fn texts(template: &str) -> Vec<String> {
    let mut found = Vec::new();
    for piece in template.split(['<', '{']) {
        let text = piece.rsplit(['>', '}']).next().unwrap();
        found.push(text.trim().to_owned());
    }
    found
}

/// The longest stretch without a placeholder, if it is a sentence's.
fn fixed_part(literal: &str) -> Option<String> {
    let mut stretches = Vec::new();
    let mut rest = literal;
    while let Some(start) = rest.find('{') {
        stretches.push(&rest[..start]);
        rest = rest[start..].find('}').map_or("", |end| &rest[start + end + 1..]);
    }
    stretches.push(rest);
    let longest = stretches.into_iter().max_by_key(|stretch| stretch.len())?.trim();
    let words = longest.split(' ').filter(|word| word.chars().any(char::is_alphabetic)).count();
    (words >= 4).then(|| longest.to_owned())
}

#[test]
fn every_sentence_is_provoked() {
    let told: String = scenes().iter().map(Scene::told).collect();
    // As the page and JSON write them.
    let plain = told
        .replace("&#x27;", "'")
        .replace("&#39;", "'")
        .replace("&quot;", "\"")
        .replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&#x2f;", "/")
        .replace("&amp;", "&");
    let mut silent = Vec::new();
    for source in SOURCES {
        let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(source)).unwrap();
        let sentences = if source.ends_with(".html") { texts(&text) } else { literals(&text) };
        for sentence in sentences.iter().filter_map(|literal| fixed_part(literal)) {
            if !plain.contains(&sentence) {
                silent.push(format!("{source}: `{sentence}`"));
            }
        }
    }
    assert!(silent.is_empty(), "no scene provokes:\n{}", silent.join("\n"));
}

/// A tool ball held 50 mm from where it is fits as well as the right one, by an arm that no maker delivers.
#[test]
fn what_is_held_wrongly_is_doubted() {
    let truth = with_errors([("a1", 0.4), ("alpha2", 6e-4), ("d4", -0.5), ("theta3", 9e-4)]);
    let said = |args: &[&'static str]| {
        let scene = Scene::new(&truth, &three_planes(1, CENTRE), 27, 0.01, args);
        scene.told().contains("warning: with tool_x, tool_y, tool_z held, ")
    };
    for prior in ["none", "datasheet"] {
        assert!(said(&["--hold", "tool", "--tool", "30,20,60", "--prior", prior]));
        assert!(!said(&["--hold", "tool", "--prior", prior]));
    }
}

/// The reader of sentences sees what it should.
#[test]
fn sentences_are_read_out_of_sources() {
    let source = "let a = \"one {x} two three four five \\\n   six\"; // \"not this one here\"\n    // \"nor this one here\"";
    assert_eq!(fixed_part(&literals(source)[0]).unwrap(), "two three four five six");
    assert_eq!(fixed_part("too {few} words"), None);
    assert_eq!(
        fixed_part(&texts("<p class=\"x\">{% if a %}the page says this{% endif %}</p>")[2]).unwrap(),
        "the page says this"
    );
}
