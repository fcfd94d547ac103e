//! Programs that leave the branch of the arm to the controller, as PolyScope and users of `ConfJ\Off` write them: the corrected
//! point is that of the branch in which the controller goes there.

use dbbd_job::program::Correction;
use dbbd_job::program::{Target, Text, rapid, urscript};
use dbbd_job::sim::truth;
use dbbd_model::robot::{Geometry, Pose, Robot, inverse};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::test_support::cell::named;

fn identified(name: &str) -> Robot {
    let nominal = named(name);
    Robot { nominal: Some(Box::new(nominal.clone())), ..truth::draw_true_robot(&nominal, 3, 1.0) }
}

fn flange(geometry: &Geometry) -> Geometry {
    Geometry { tool: Vector3::zeros(), ..geometry.clone() }
}

/// How far the identified robot is from `wanted`, a pose of its flange, if its controller goes to `target` in the branch next to
/// `near`, and the largest angle between the axes and `near`, mm and rad.
fn off(robot: &Robot, target: &Target, near: &[f64; 6], wanted: &Pose) -> [f64; 2] {
    let Target::Pose { xyz_mm, abc_deg, .. } = *target else { panic!("not a pose") };
    let nominal = flange(&robot.nominal.as_ref().unwrap().geometry);
    let axes = inverse::nearest(&nominal, &Pose::from_kuka(xyz_mm, abc_deg), near).unwrap();
    let turn = axes.iter().zip(near).map(|(axis, near)| (axis - near).abs()).fold(0.0, f64::max);
    [(flange(&robot.geometry).ball(&axes).position - wanted.position).norm(), turn]
}

/// `get_inverse_kin(P, qnear=Q)`: P is corrected for the branch next to Q, which stays.
#[test]
fn inverse_kinematics_keep_their_branch() {
    let robot = identified("ur10");
    let nominal = flange(&robot.nominal.as_ref().unwrap().geometry);
    // Elbow up and elbow down.
    for near in [[0.3, -1.4, 1.8, -1.9, -1.5, 0.4], [0.3, 0.3, -1.8, -0.1, -1.5, 0.4]] {
        let wanted = nominal.ball(&near);
        let turn = dbbd_model::robot::pose::rotation_vector(&wanted.rotation);
        let place = wanted.position * 1e-3;
        let text = format!(
            "def f():\n  set_tcp(p[0,0,0,0,0,0])\n  global w_p=p[{:.9}, {:.9}, {:.9}, {:.9}, {:.9}, {:.9}]\n  global w_q={near:?}\n  \
             $ 3 \"w\" \"breakAfter\"\n  movej(get_inverse_kin(w_p, qnear=w_q), a=1.4, v=1.05)\nend\n",
            place.x, place.y, place.z, turn.x, turn.y, turn.z
        );
        let read = |text| urscript::read(Text { file: "P.script", text }, None).unwrap();
        let before = read(&text);
        let (corrected, moved) =
            before.compensate(Text { file: "P.script", text: &text }, Correction::of(&robot, 20.0)).unwrap();
        assert_eq!(moved.len(), 1);
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
        let changed: Vec<usize> =
            (0..7).filter(|line| lines(&text)[*line] != lines(&corrected)[*line]).collect();
        assert_eq!(changed, [2]);
        let [uncorrected_mm, _] = off(&robot, &before.points[0].target, &near, &wanted);
        let [off_mm, turn] = off(&robot, &read(&corrected).points[0].target, &near, &wanted);
        assert!(uncorrected_mm > 0.1 && off_mm < 1e-3 && turn < 0.05, "{uncorrected_mm} {off_mm} {turn}");
    }
}

/// With `ConfJ\Off` the robot goes to the branch next to where it is, and the configuration of the point is a dummy, which stays.
/// With `ConfJ\On` the same configuration is not reached.
#[test]
fn dummy_configurations_stay() {
    let robot = identified("irb1600-10-145");
    let nominal = flange(&robot.nominal.as_ref().unwrap().geometry);
    let near = [100.0, 10.0, 5.0, 110.0, 40.0, -95.0_f64].map(f64::to_radians);
    let wanted = nominal.ball(&near);
    assert_ne!(inverse::quadrants(&nominal, &near), [0; 4]);
    let (place, turn): ([f64; 3], _) = (wanted.position.into(), wanted.quaternion());
    let program = |switch: &str, motion: &str| {
        format!(
            "MODULE M\nPROC main()\n{switch}\nMoveAbsJ [[98,11,4,111,41,-94],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;\n\
             {motion} [{place:?},{turn:?},[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;\nENDPROC\nENDMODULE\n"
        )
    };
    let corrected = |text: &str| {
        let file = Text { file: "M.mod", text };
        rapid::read(file, None).unwrap().compensate(file, Correction::of(&robot, 20.0))
    };
    for motion in ["MoveJ", "MoveL"] {
        let (text, _) = corrected(&program("ConfJ\\Off; ConfL\\Off;", motion)).unwrap();
        assert!(text.contains("[0,0,0,0]"), "{text}");
        let target = rapid::read(Text { file: "M.mod", text: &text }, None).unwrap().points[1].target.clone();
        let [off_mm, turn] = off(&robot, &target, &near, &wanted);
        assert!(off_mm < 2e-3 && turn < 0.05, "{motion} {off_mm} {turn}");
    }
    assert_eq!(corrected(&program("", "MoveJ")).unwrap_err()[0].code().as_str(), "E0906");
}

/// A program that begins with a pose selects no branch: where the arm was before is not known. A motion to axis angles selects
/// it.
#[test]
fn first_pose_without_a_branch_is_refused() {
    let robot = identified("ur10");
    let start = "  movej([0.3, -1.4, 1.8, -1.9, -1.5, 0.4])\n";
    let corrected = |start: &str, motion: &str| {
        let text =
            format!("def f():\n  set_tcp(p[0,0,0,0,0,0])\n{start}  {motion}(p[0.6,0.1,0.4,3.14,0,0])\nend\n");
        let file = Text { file: "P.script", text: &text };
        urscript::read(file, None).unwrap().compensate(file, Correction::of(&robot, 20.0))
    };
    for motion in ["movej", "movel"] {
        let refused = corrected("", motion).unwrap_err();
        assert_eq!(refused.iter().map(|one| one.code().as_str()).collect::<Vec<_>>(), ["E0923"]);
        assert!(corrected(start, motion).is_ok(), "{motion}");
    }
}

/// Away from the singularity of the wrist.
const START_DEG: [f64; 6] = [0.0, 0.0, 0.0, 0.0, 30.0, 0.0];

/// The controller goes to no branch beyond the limits, however near it is to where the robot is.
#[test]
fn branches_beyond_the_limits_are_none() {
    let robot = identified("irb1600-10-145");
    let nominal = robot.nominal.as_ref().unwrap();
    let arm = flange(&nominal.geometry);
    let mut random = Pcg64::seed_from_u64(3);
    let (mut cases, mut corrected, mut codes) = (0, 0, Vec::new());
    for _ in 0..400 {
        let axes: [f64; 6] = std::array::from_fn(|i| {
            let [low, high] = nominal.limits_deg[i];
            random.random_range(low + 10.0..high - 10.0).to_radians()
        });
        let wanted = arm.ball(&axes);
        let nearest = inverse::nearest(&arm, &wanted, &START_DEG.map(f64::to_radians)).unwrap();
        let limits_deg = nominal.limits_at_deg(&nearest.map(f64::to_degrees));
        if nearest.iter().zip(limits_deg).all(|(axis, [low, high])| (low..=high).contains(&axis.to_degrees()))
        {
            continue;
        }
        let (place, turn): ([f64; 3], _) = (wanted.position.into(), wanted.quaternion());
        let text = format!(
            "MODULE M\nPROC main()\nConfJ\\Off;\nMoveAbsJ [{START_DEG:?},[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;\n\
             MoveJ [{place:?},{turn:?},[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;\nENDPROC\nENDMODULE\n"
        );
        let file = Text { file: "M.mod", text: &text };
        cases += 1;
        match rapid::read(file, None).unwrap().compensate(file, Correction::of(&robot, 20.0)) {
            Ok(_) => corrected += 1,
            Err(refused) => codes.extend(refused.iter().map(ToString::to_string)),
        }
    }
    // The others are beside a singularity or a limit.
    assert!(cases > 20 && 10 * corrected > 9 * cases, "{corrected} of {cases}: {codes:?}");
}
