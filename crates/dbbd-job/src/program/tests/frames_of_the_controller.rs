//! Robots that stand elsewhere than in the origin of their World, and whose flange is another one than the table's.

use dbbd_job::plan::{Job, Plan, PoseKind};
use dbbd_job::program::krl::{self, Controller, Files, Given, Options, Program, Sync, absolute_accuracy};
use dbbd_job::program::{Correction, Text};
use dbbd_job::sim::SimulatedController;
use dbbd_model::robot::{ControllerFrames, Joint, ParamId, Pose, Robot};
use nalgebra::Vector3;

use crate::test_support::cell::kr60;
use crate::test_support::makes::job;

/// A robot on a pedestal that is turned, with a flange that is turned by half a turn about X.
pub(super) fn elsewhere(robot: Robot) -> Robot {
    let frames = ControllerFrames {
        base: Pose::from_kuka([200.0, -100.0, 500.0], [30.0, 0.0, 0.0]),
        flange: Pose::from_kuka([0.0, 0.0, 12.0], [0.0, 0.0, 180.0]),
    };
    Robot { frames, ..robot }
}

fn plan(robot: &Robot) -> Plan {
    let text =
        job("kr60ha", [1300.0, 0.0, 800.0], 8).replace("tilt_deg = 15.0", "tilt_deg = 15.0\nspin_deg = 60.0");
    Plan::build(&Job::from_toml("job.toml", &text).unwrap(), robot).unwrap()
}

/// The measuring program of a robot that stands elsewhere moves the ball to the poses of the plan, and logs whether the controller corrects
/// by itself: the variable is a BOOL in KSS 5 and an ENUM in KSS 8.
#[test]
fn krl_moves_where_the_plan_is_and_knows_its_controller() {
    let robot = elsewhere(kr60());
    let plan = plan(&robot);
    for (version, is_active) in
        [Controller::Krc2, Controller::Krc4, Controller::Krc5].map(|of| [(of, false), (of, true)]).concat()
    {
        let files = krl::emit(&plan, Options { sync: Sync::Output, controller: version }).unwrap();
        let program = Program::open("DBB_MAIN", |wanted| {
            Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
        });
        let mut controller = SimulatedController::new(program.unwrap(), &robot, 100.0).unwrap();
        if is_active {
            controller.set_absolute_accuracy();
        }
        let mut dwells: Vec<Vector3<f64>> = Vec::new();
        let mut was_high_s = 0.0;
        for _ in 0..500_000 {
            let moment = controller.step(0.02).unwrap();
            was_high_s = if moment.strobe { was_high_s + 0.02 } else { 0.0 };
            // Pulses of the marker last 0.2 s.
            if (0.31..0.33).contains(&was_high_s) {
                dwells.push(robot.geometry.ball(&moment.axes).position);
            }
            if moment.halted {
                controller.go_on();
            }
            if moment.done {
                break;
            }
        }
        let rows: Vec<_> = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).collect();
        assert_eq!(dwells.len(), rows.len());
        for (found, row) in dwells.iter().zip(rows) {
            assert!((found - Vector3::from(row.xyz_mm)).norm() < 2e-3, "{found} {:?}", row.xyz_mm);
        }
        let saved = controller.saved();
        let logged: Vec<bool> = saved
            .iter()
            .filter_map(|(name, text)| absolute_accuracy(&krl::parse_data(name, text).ok()?))
            .collect();
        assert!(logged.contains(&is_active) && !logged.contains(&!is_active), "{version:?}: {logged:?}");
    }
}

/// The type of the variable is the controller's: KRL assigns no ENUM to a BOOL.
#[test]
fn a_program_of_kss5_does_not_run_on_kss8() {
    let plan = plan(&kr60());
    let mut files = krl::emit(&plan, Options { sync: Sync::Marker, controller: Controller::Krc2 }).unwrap();
    for (_, text) in &mut files {
        *text = text.replace("EXT BAS (BAS_COMMAND :IN,REAL :IN )", "");
    }
    let program = Program::open("DBB_MAIN", |wanted| {
        Ok(files.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted)).cloned())
    });
    let mut controller = SimulatedController::new(program.unwrap(), &kr60(), 100.0).unwrap();
    let wrong = (0..500).find_map(|_| controller.step(0.02).err()).unwrap();
    assert!(wrong.to_string().contains("BOOL"), "{wrong}");
}

/// A base in the World is the base that the robot has there, and a tool on the other flange the tool on the table's.
#[test]
fn programs_are_corrected_in_the_frames_of_the_controller() {
    let nominal = kr60();
    let mut identified = nominal.clone();
    for (id, by) in
        [(ParamId::Theta(Joint::J2), 1e-3), (ParamId::A(Joint::J3), 0.7), (ParamId::D(Joint::J4), -0.4)]
    {
        *identified.geometry.value_mut(id).unwrap() += by;
    }
    let corrected = |base: [f64; 6], tool: [f64; 6], nominal: Robot| {
        let robot = Robot { nominal: Some(Box::new(nominal)), ..identified.clone() };
        let frame = |[x, y, z, a, b, c]: [f64; 6]| format!("{{X {x},Y {y},Z {z},A {a},B {b},C {c}}}");
        let text = format!(
            "DEF P()\n$TOOL={}\n$BASE={}\nPTP {{A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 30.0,A6 0.0}}\nLIN {{X 1300.000,Y 0.000,Z 1500.000,A 160.0000,B 60.0000,C 170.0000}}\nEND\n",
            frame(tool),
            frame(base)
        );
        let files = Files { source: Text { file: "P.src", text: &text }, data: None, config: None };
        let points = krl::read(files, Given::default()).unwrap();
        let done = krl::compensate(files, &points, Correction::of(&robot, 20.0)).unwrap();
        done.source.lines().find(|line| line.starts_with("LIN")).unwrap().to_owned()
    };
    let pedestal = |robot: Robot| {
        let base = Pose::from_kuka([0.0, 0.0, 500.0], [0.0; 3]);
        Robot { frames: ControllerFrames { base, ..robot.frames }, ..robot }
    };
    let flipped = |robot: Robot| {
        let flange = Pose::from_kuka([0.0; 3], [0.0, 0.0, 180.0]);
        Robot { frames: ControllerFrames { flange, ..robot.frames }, ..robot }
    };
    let (null, tool) = ([0.0; 6], [0.0, 0.0, 120.0, 0.0, 0.0, 0.0]);
    let expected = corrected([0.0, 0.0, -500.0, 0.0, 0.0, 0.0], tool, nominal.clone());
    assert_eq!(corrected(null, tool, pedestal(nominal.clone())), expected);
    assert_ne!(corrected(null, tool, nominal.clone()), expected);
    let behind = corrected(null, [0.0, 0.0, -120.0, 0.0, 0.0, 180.0], flipped(nominal.clone()));
    assert_eq!(behind, corrected(null, tool, nominal));
}
