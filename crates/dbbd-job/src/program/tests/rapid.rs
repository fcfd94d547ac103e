//! Properties of RAPID: the end of a motion, and the configuration of the axes.

use dbbd_job::program::rapid;
use dbbd_job::sim::SimulatedController;
use dbbd_model::robot::inverse;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::test_support::cell::named;

/// One project found on the virtual controller of an ABB these errors of a pose: 1.3 mm without a wait, 0.28 mm with `\InPos`, none
/// with `\ZeroSpeed` and 0.2 s. The errors of the simulated controller have the same order of magnitude.
#[test]
fn motion_ends_before_standstill() {
    let robot = named("irb1600-10-145");
    let off = |waits: &str| {
        let text = format!(
            "MODULE M\nCONST jointtarget a:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n\
             CONST jointtarget b:=[[20,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\nPROC main()\n\
             MoveAbsJ a,v100,fine,tool0;\nWaitTime 3;\nMoveAbsJ b,v1000,fine,tool0;\n{waits}Stop;\nENDPROC\nENDMODULE\n"
        );
        let mut controller =
            SimulatedController::new(rapid::open(("M.mod".into(), text), vec![]).unwrap(), &robot, 100.0)
                .unwrap();
        let halted = loop {
            let moment = controller.step(0.002).unwrap();
            if moment.halted {
                break moment;
            }
        };
        let there = |axes: &[f64; 6]| robot.geometry.ball(axes).position;
        let wanted = there(&[20.0, 0.0, 0.0, 0.0, 30.0, 0.0].map(f64::to_radians));
        (there(&halted.axes) - wanted).norm()
    };
    let [none, position, speed] =
        ["", "WaitRob\\InPos;\n", "WaitRob\\InPos;\nWaitRob\\ZeroSpeed;\nWaitTime 0.2;\n"].map(off);
    assert!(none > 1.0 && (0.1..0.5).contains(&position) && speed < 0.003, "{none} {position} {speed}");
}

/// ABB's configuration by the table of the RAPID reference: quadrants, and `cfx` with the arm in front and the wrist up.
#[test]
fn configurations_distinguish_solution_branches() {
    let robot = named("irb1600-10-145");
    let mut random = Pcg64::seed_from_u64(1);
    let mut recovered = 0;
    for _ in 0..200 {
        let axes: [f64; 6] = std::array::from_fn(|i| {
            let [low, high] = robot.limits_deg[i];
            random.random_range(low..high).to_radians()
        });
        let wanted = inverse::quadrants(&robot.geometry, &axes);
        for (at, axis) in [0, 3, 5].into_iter().enumerate() {
            assert_eq!(f64::from(wanted[at]), (axes[axis].to_degrees() / 90.0).floor());
        }
        assert_eq!(wanted[3] % 2 == 1, axes[4] < 0.0);
        let found = inverse::from_quadrants(&robot, &robot.geometry.ball(&axes), wanted).unwrap();
        recovered += usize::from(found.iter().zip(&axes).all(|(a, b)| (a - b).abs() < 1e-6));
    }
    // Two solutions with the same quadrants of axes 4 and 6 differ in the sign of axis 5, and so in `cfx`.
    assert_eq!(recovered, 200);
    assert_eq!(inverse::quadrants(&robot.geometry, &[0.1, 0.1, 0.1, 0.1, 0.5, 0.1]), [0, 0, 0, 0]);
}

/// If a line does not end in its configuration, that is an error with `ConfL\On` and ignored with `ConfL\Off`.
#[test]
fn lines_check_their_configuration() {
    let robot = named("irb1600-10-145");
    let run = |switch: &str| {
        let ball = robot.geometry.ball(&[0.0, 10.0, 5.0, 10.0, 40.0, 5.0].map(f64::to_radians));
        let (place, turn): ([f64; 3], _) = (ball.position.into(), ball.quaternion());
        let text = format!(
            "MODULE M\nPROC main()\nMoveAbsJ [[5,10,5,10,40,5],[]],v100,fine,tool0;\n{switch};\n\
             MoveL [{place:?},{turn:?},[1,0,0,0],[]],v100,fine,tool0;\nENDPROC\nENDMODULE\n"
        );
        let listing = rapid::open(("M.mod".into(), text), vec![]).unwrap();
        SimulatedController::new(listing, &robot, 100.0).and_then(|mut controller| controller.step(60.0))
    };
    assert_eq!(run("ConfL\\On").unwrap_err().code().as_str(), "E0813");
    assert!(run("ConfL\\Off").unwrap().done);
}
