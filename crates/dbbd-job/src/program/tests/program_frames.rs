//! The program uses the frames of the job, and the arm reaches the poses of the plan whatever the frames are.

use dbbd_job::plan::{self, Job, Plan};
use dbbd_job::program::krl::{Controller as Kind, Options, Program, Sync, emit};
use dbbd_job::sim::SimulatedController;
use dbbd_model::robot::Robot;

const JOB: &str = r#"
robot = "kr60ha"
[tool]
ball_mm = [30.0, 20.0, 10.0]
[bar]
length_mm = 300.0
stroke_mm = [-5.0, 5.0]
[[centre]]
id = 1
xyz_mm = [1300.0, 0.0, 800.0]
[[circle]]
plane = "XY"
points = 8
amplitude_deg = 20.0
tilt_deg = 20.0
[motion]
dwell_s = 0.2
"#;

/// The program of a job, and the largest difference of an axis from the plan at a dwell, degrees.
fn executed(text: &str) -> (String, f64) {
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    let job = Job::from_toml("job.toml", text).unwrap();
    job.check_against(&robot).unwrap();
    let plan = Plan::build(&job, &robot).unwrap();
    let files = emit(&plan, Options { sync: Sync::Output, controller: Kind::Krc4 }).unwrap();
    let data = files.iter().find(|(name, _)| name == "DBB_C001.dat").unwrap().1.clone();
    let program = Program::open("DBB_MAIN", |wanted| {
        Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
    })
    .unwrap();
    let mut controller = SimulatedController::new(program, &robot, 100.0).unwrap();
    let dwells: Vec<_> = plan.rows.iter().filter(|row| row.kind != plan::PoseKind::Transit).collect();
    let mut worst: f64 = 0.0;
    loop {
        let before = controller.dwells();
        let moment = controller.step(0.05).unwrap();
        if moment.halted {
            controller.go_on();
        }
        // The strobe is low again, and the robot is still at rest.
        if controller.dwells() > before {
            let row = dwells[before as usize];
            let off = moment.axes.iter().zip(&row.axes_deg).map(|(a, b)| (a.to_degrees() - b).abs());
            worst = off.fold(worst, f64::max);
        }
        if moment.done {
            return (data, worst);
        }
    }
}

#[test]
fn tool_and_base_of_the_job_are_used() {
    let (data, worst) = executed(JOB);
    assert!(data.contains("FBASE={X 0.000,Y 0.000,Z 0.000,A 0.0000,B 0.0000,C 0.0000}"), "{data}");
    assert!(worst < 1e-6, "{worst}");
    let framed = "[motion]\ntool = [30.0, 20.0, 10.0, 0.0, 90.0, 45.0]\nbase = [900.0, -200.0, 400.0, 30.0, 5.0, -10.0]";
    let (data, worst) = executed(&JOB.replace("[motion]", framed));
    assert!(data.contains("FBASE={X 900.000,Y -200.000,Z 400.000,A 30.0000,B 5.0000,C -10.0000}"), "{data}");
    assert!(data.contains("FTOOL={X 30.000,Y 20.000,Z 10.000,A 0.0000,B 90.0000,C 45.0000}"), "{data}");
    assert!(worst < 1e-6, "{worst}");
}

/// The optimal orientations of the tool leave a smaller uncertainty than random ones of any seed.
#[test]
fn optimal_orientation_is_better_than_random_ones() {
    let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
    let error = |orientation: &str, seed: u32| {
        let text = JOB
            .replace("points = 8", &format!("points = 40\norientation = \"{orientation}\""))
            .replace("[tool]", &format!("seed = {seed}\n[tool]"));
        let job = Job::from_toml("job.toml", &text).unwrap();
        let mut plan = Plan::build(&job, &robot).unwrap_or_else(|refused| panic!("{refused}"));
        let prior = plan::PlanningPrior::datasheet(&job, &robot);
        plan.predict(&robot, &prior);
        plan.header.predictions.unwrap().identified_mm.mean
    };
    let random = (1..=3).map(|seed| error("random", seed)).fold(f64::INFINITY, f64::min);
    let optimal = error("optimal", 1);
    assert!(optimal < random, "{optimal} {random}");
}
