//! Goals: a plan that reaches one leaves at most its error on robots that are drawn from what is known.

use dbbd_job::plan::goal::plan_for_goal;
use dbbd_job::plan::workspace::workspace;
use dbbd_job::plan::{Job, KnownCell, Plan, PlanningPrior};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::plan_states_the_result::{identified, mean_error_at_mm};
use crate::cell::{codes, dbbd, stderr};
use crate::support::spoken::assert_spoken;

/// Robots on which each plan is measured.
const ROBOTS_OF_GOAL: u64 = 4;

const ROBOTS: [&str; 3] = ["kr60ha", "ur10", "irb4600-60-205"];

fn robot(name: &str) -> Robot {
    Robot::by_name_with_tool(name, [30.0, 20.0, 10.0]).unwrap().unwrap()
}

/// A job with a goal in a cell that is drawn: places about the robot, one or two bars, all of the reach or a box.
fn drawn_job(seed: u64) -> Job {
    let mut random = Pcg64::seed_from_u64(seed);
    let name = ROBOTS[random.random_range(0..ROBOTS.len())];
    let reach = robot(name).reach_mm();
    // Evenly on a logarithmic scale, in a box or in all of the reach.
    let in_box = random.random_bool(0.5);
    let goal_mm = if in_box { 0.15 } else { 0.5 } * f64::powf(8.0, random.random_range(0.0..1.0));
    let mut text = format!(
        "robot = \"{name}\"\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nstroke_mm = [-25.0, 25.0]\nlength_u_mm = 0.004\n\
         [motion]\nfeed_mm_s = 150.0\n[limits]\nmin_overhead_mm = 50.0\n\
         [goal]\nposition_mm = {goal_mm:.3}\nminutes_per_ball = 4.0\nminutes_per_bar = 6.0\nseconds_per_pose = 12.0\n"
    );
    if in_box {
        let [x, z] =
            [random.random_range(0.45..0.6), random.random_range(0.2..0.4)].map(|share| share * reach);
        let half = 0.12 * reach;
        text += &format!(
            "region_mm = [[{:.0}.0, {:.0}.0, {:.0}.0], [{:.0}.0, {:.0}.0, {:.0}.0]]\n",
            x - half,
            -half,
            z - half,
            x + half,
            half,
            z + half
        );
    }
    for length in [0.2, 0.35].into_iter().take(random.random_range(1..3)) {
        text += &format!("[[bar_choice]]\nlength_mm = {:.0}.0\n", length * reach);
    }
    for at in 0..random.random_range(2..5) {
        let angle = at as f64 * 1.4 - 2.0 + random.random_range(-0.4..0.4);
        let away = reach * random.random_range(0.4..0.65);
        let z = reach * random.random_range(0.05..0.6);
        text += &format!(
            "[[place]]\nxyz_mm = [{:.1}, {:.1}, {z:.1}]\n",
            away * f64::cos(angle),
            away * f64::sin(angle)
        );
    }
    Job::from_toml("job.toml", &text).unwrap()
}

fn cell(job: Job, robot: &Robot) -> Result<KnownCell, Diagnostic> {
    let prior = PlanningPrior::datasheet(&job, robot);
    Ok(KnownCell { job, robot: robot.clone(), prior })
}

/// The plan of a job with a goal, or the codes of its refusal.
fn planned(job: &Job, robot: &Robot) -> Result<Plan, Vec<String>> {
    let mounted = cell(job.clone(), robot).unwrap();
    let goal = job.goal.as_ref().unwrap();
    let found = plan_for_goal(goal, &mounted, &|job| cell(job, robot));
    found.map(|(plan, _)| plan).map_err(|refusal| refusal.printed().map(|one| one.to_string()).collect())
}

const WISH: &str = r#"
robot = "kr60ha"
[tool]
ball_mm = [30.0, 20.0, 10.0]
[bar]
stroke_mm = [-20.0, 20.0]
length_u_mm = 0.003
[goal]
position_mm = 0.4
region_mm = [[900.0, -300.0, 500.0], [1500.0, 300.0, 1100.0]]
[[bar_choice]]
length_mm = 600.0
[[place]]
xyz_mm = [1400.0, 0.0, 700.0]
[[place]]
box_mm = [[200.0, 900.0, 600.0], [800.0, 1200.0, 600.0]]
"#;

/// A wish becomes a plan, whose job plans the same cell again; a smaller wish says what limits it, and a shorter time what it takes.
#[test]
fn a_wish_becomes_a_plan_or_a_reason() {
    let directory = tempfile::tempdir().unwrap();
    let dir = directory.path();
    let plan = |name: &str, text: &str| {
        std::fs::write(dir.join(name), text).unwrap();
        dbbd(dir, &["plan", name, "--out", &format!("{name}.plan")])
    };
    let done = plan("wish.toml", WISH);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let goal = |name: &str| {
        let text = std::fs::read_to_string(dir.join(format!("{name}.plan/plan.json"))).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap()["goal"].clone()
    };
    let first = goal("wish.toml");
    let reached_mm = first["reached_mm"].as_f64().unwrap();
    assert!((0.2..=0.4).contains(&reached_mm), "{first}");
    let curve = first["curve"].as_array().unwrap();
    let of = |key: &str| curve.iter().map(|point| point[key].as_f64().unwrap()).collect::<Vec<f64>>();
    let (minutes, errors) = (of("minutes"), of("position_mm"));
    assert!(minutes.is_sorted() && errors.iter().rev().is_sorted() && curve.len() >= 4, "{first}");
    assert_spoken(&std::fs::read_to_string(dir.join("wish.toml.plan/plan.html")).unwrap());
    // The chosen job is a job: the balls stand, and only the number of poses is open.
    let chosen = std::fs::read_to_string(dir.join("wish.toml.plan/job.toml")).unwrap();
    assert!(chosen.contains("[[centre]]") && !chosen.contains("[[place]]"), "{chosen}");
    let again = plan("chosen.toml", &chosen);
    assert_eq!(again.status.code(), Some(0), "{}", stderr(&again));
    let again = goal("chosen.toml")["reached_mm"].as_f64().unwrap();
    assert!((0.2..=0.4).contains(&again), "{again}");

    let small = plan("small.toml", &WISH.replace("position_mm = 0.4", "position_mm = 0.004"));
    assert_eq!(small.status.code(), Some(1));
    assert!(
        codes(&small).contains(&"E0750".into()) && codes(&small).contains(&"I0751".into()),
        "{}",
        stderr(&small)
    );
    assert!(!dir.join("small.toml.plan").exists());
    // What is wrong is said of what is wrong.
    let near = "[[900.0, -300.0, 500.0], [1500.0, 300.0, 1100.0]]";
    let far = plan("far.toml", &WISH.replace(near, "[[9000.0, -300.0, 500.0], [9500.0, 300.0, 1100.0]]"));
    assert_eq!(far.status.code(), Some(1));
    assert!(stderr(&far).contains("no pose with the tool in `region_mm`"), "{}", stderr(&far));
    let stage = dbbd(dir, &["plan", "wish.toml", "--stage", "20", "--out", "stage"]);
    assert_eq!(
        (stage.status.code(), codes(&stage)),
        (Some(1), vec!["E0603".to_owned()]),
        "{}",
        stderr(&stage)
    );
    let short = plan(
        "short.toml",
        &WISH.replace(
            "[goal]",
            "[goal]
minutes = 22.0",
        ),
    );
    assert_eq!(short.status.code(), Some(1));
    assert!(stderr(&short).contains("reach it in"), "{}", stderr(&short));
}

/// What is wrong in a wish, with its line.
#[test]
fn a_wish_that_cannot_be_names_its_line() {
    for (of, by, line, code) in [
        ("position_mm = 0.4", "position_mm = 40.0", 9, "E0130"),
        ("position_mm = 0.4", "position_mm = 0.0003", 9, "E0130"),
        ("position_mm = 0.4", "position_mm = nan", 9, "E0130"),
        ("position_mm = 0.4", "position_mm = 0.4\nminutes = 0.0", 10, "E0130"),
        ("position_mm = 0.4", "position_mm = 0.4\nof = \"median\"", 10, "E0120"),
        ("position_mm = 0.4", "position_mm = 0.4\nprogram = \"a.src\"", 10, "E0603"),
        (
            "[[900.0, -300.0, 500.0], [1500.0, 300.0, 1100.0]]",
            "[[0.9, -0.3, 0.5], [1.5, 0.3, 1.1]]",
            10,
            "E0130",
        ),
        ("length_mm = 600.0", "length_mm = 0.6", 12, "E0130"),
        ("xyz_mm = [1400.0, 0.0, 700.0]", "cup_axis = [0.0, 0.0, 1.0]", 13, "E0603"),
        (
            "[[200.0, 900.0, 600.0], [800.0, 1200.0, 600.0]]",
            "[[800.0, 900.0, 600.0], [200.0, 1200.0, 600.0]]",
            16,
            "E0602",
        ),
        ("[goal]\nposition_mm = 0.4", "# [goal]", 0, "E0120"),
    ] {
        let text = WISH.replace(of, by);
        let wrong = Job::from_toml("job.toml", &text).unwrap_err();
        assert_eq!(wrong.code().to_string(), code, "{by}: {wrong}");
        assert!(line == 0 || wrong.line_number() == line, "{by}: {wrong}");
    }
    let bare = WISH.split("[goal]").next().unwrap().replace("[bar]", "[bar]\nlength_mm = 300.0");
    assert_eq!(Job::from_toml("job.toml", &bare).unwrap_err().code().to_string(), "E0603");
    // Neither circles nor poses nor a goal: chosen poses.
    let centre = format!("{bare}[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n");
    assert_eq!(Job::from_toml("job.toml", &centre).unwrap().optimise.unwrap().points, 210);
    let placed = format!("{centre}[[place]]\nxyz_mm = [1300.0, 0.0, 800.0]\n");
    assert_eq!(Job::from_toml("job.toml", &placed).unwrap_err().code().to_string(), "E0603");
}

/// `GOALS=1..101 cargo test --release --test suite drawn_goals -- --ignored --nocapture`
#[test]
#[ignore = "takes an hour"]
fn drawn_goals_are_reached() {
    let range = std::env::var("GOALS").unwrap_or("1..101".into());
    let (first, past) = range.split_once("..").unwrap();
    let seeds = first.parse::<u64>().unwrap()..past.parse().unwrap();
    let (mut accepted, mut reached, jobs) = (0_u32, 0, seeds.end - seeds.start);
    for seed in seeds {
        let job = drawn_job(seed);
        let robot = robot(&job.robot);
        let goal = job.goal.clone().unwrap();
        match planned(&job, &robot) {
            Ok(plan) => {
                let outcome = plan.header.goal.clone().unwrap();
                let poses = workspace(&job, &robot, 400);
                let truth = |robot_seed: u64| {
                    let (truth, found, _) = identified(&plan, &robot, 1000 * seed + robot_seed);
                    mean_error_at_mm(&truth, &found, &poses)
                };
                let true_mm: Vec<f64> = (0..ROBOTS_OF_GOAL).map(truth).collect();
                accepted += 1;
                reached += true_mm.iter().filter(|error| **error <= goal.position_mm).count();
                eprintln!(
                    "{seed} {}: goal {:.3}, kept {:.3}, true {true_mm:.3?}, {:.0} min, {} balls, {} poses",
                    job.robot,
                    goal.position_mm,
                    outcome.reached_mm,
                    outcome.minutes,
                    plan.header.job.centres.len(),
                    plan.rows.iter().filter(|row| row.dwell_s > 0.0).count()
                );
            }
            Err(why) => {
                eprintln!("{seed} {}: goal {:.3} refused: {}", job.robot, goal.position_mm, why.join("; "))
            }
        }
    }
    eprintln!("{accepted} of {jobs} accepted, {reached} reached");
    assert!(u64::from(accepted) * 10 >= jobs * 6, "{accepted}");
    // 85 % less two standard deviations of a binomial distribution.
    let robots = f64::from(accepted) * ROBOTS_OF_GOAL as f64;
    let least = 0.85 - 2.0 * (0.85 * 0.15 / f64::from(accepted)).sqrt();
    assert!(reached as f64 >= least * robots, "{reached} of {robots}");
}
