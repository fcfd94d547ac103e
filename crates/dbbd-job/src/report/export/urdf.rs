//! The robot as a URDF, in metres and radians. A joint variable is the controller's axis angle. URDF has no form for a
//! coupled joint: its variable is the joint's own angle, a sum of axis angles.
//!
//! Row i is `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)`. A URDF joint is a fixed origin followed by a turn about its axis, so
//! that joint i's origin is the shift d of the row before, then `Ry(beta) Rx(alpha) Tx(a) Rz(offset)`, and its axis is z with
//! the sense of the controller's angle. URDF has no compliance and no errors of joints: a comment states the position error
//! without them.
//!
//! One file for every reader. Drake needs a link `world`, efforts and transmissions, MuJoCo needs masses and inertias
//! above zero. Values that are not known are placeholders, and comments say so.

use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};

use dbbd_model::estimation::SimplifiedModelError;
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{AXES, Joint, Mass, Payload, Pose, Robot};

/// Placeholder for efforts that are not known, N m: a joint without effort has no actuator.
const PLACEHOLDER_EFFORT_NM: f64 = 1000.0;
/// Placeholder for masses that are not known, kg.
const PLACEHOLDER_KG: f64 = 1.0;
/// Added to every inertia, kg m^2: inertias of point masses are zero about some axis.
const PLACEHOLDER_INERTIA_KG_M2: f64 = 0.01;

/// The URDF of a robot: links `world`, `base_link`, `link_1` to `link_6`, `flange` and `ball`; `base` and `tool0` are where its controller
/// counts from (REP 199).
pub fn urdf(robot: &Robot) -> String {
    let mut text = String::from("<?xml version=\"1.0\"?>\n");
    let _ =
        writeln!(text, "<!-- {}. Joint variables are the controller's axis angles.", comment(&robot.name));
    let _ = writeln!(
        text,
        "     Efforts of {PLACEHOLDER_EFFORT_NM} N m are placeholders. Of inertias only masses are known, as points: {PLACEHOLDER_INERTIA_KG_M2} kg m^2 is \
         added to each,\n     and a link of {PLACEHOLDER_KG} kg whose comment says so is a placeholder. -->"
    );
    for CoupledJoint { number, sum } in coupled(robot) {
        let _ = writeln!(text, "<!-- The variable of joint {number} is {sum}. -->");
    }
    if let Some(SimplifiedModelError { mean_mm: mm, .. }) = SimplifiedModelError::of(robot) {
        let _ = writeln!(
            text,
            "<!-- Without compliance and errors of the joints: the ball is {mm:.3} mm off in the mean over the workspace. -->"
        );
    }
    let _ = writeln!(text, "<robot name=\"{}\">", name(&robot.name));
    text.push_str("  <!-- MuJoCo keeps the links that are fixed to others. -->\n  <mujoco><compiler fusestatic=\"false\"/></mujoco>\n");
    text.push_str("  <link name=\"world\"/>\n");
    let along = |mm: Vector3<f64>| Pose { position: mm, ..Pose::identity() };
    text.push_str(&fixed("base_link", "world", &Pose::identity()));
    text.push_str(&fixed("base", "base_link", &robot.frames.base.inverse()));
    let mut before_mm = 0.0;
    for (at, row) in robot.geometry.rows.iter().enumerate() {
        let number = at + 1;
        let turned = rot_y(row.beta) * rot_x(row.alpha);
        let origin = Vector3::z() * before_mm + turned * Vector3::x() * row.a;
        let [low, high] = robot.joint_range_deg(Joint::ALL[at]).map(f64::to_radians);
        let _ = write!(
            text,
            "  <joint name=\"joint_a{number}\" type=\"revolute\">\n    <parent link=\"{}\"/>\n    <child link=\"link_{number}\"/>\n    {}\n    \
             <axis xyz=\"0 0 {}\"/>\n    <limit lower=\"{low}\" upper=\"{high}\" effort=\"{PLACEHOLDER_EFFORT_NM}\" velocity=\"{}\"/>\n  </joint>\n",
            if at == 0 { "base_link".into() } else { format!("link_{at}") },
            origin_tag(&origin, &(turned * rot_z(row.theta))),
            row.sign,
            robot.max_speed_deg_s[at].to_radians(),
        );
        text.push_str(&link(robot, number, row.d));
        before_mm = row.d;
    }
    text.push_str(&fixed("flange", &format!("link_{AXES}"), &along(Vector3::z() * before_mm)));
    text.push_str(&fixed("tool0", "flange", &robot.frames.flange));
    text.push_str(&fixed("ball", "flange", &along(robot.geometry.tool)));
    // Drake makes actuators of the transmissions.
    for number in 1..=AXES {
        let _ = writeln!(
            text,
            "  <transmission name=\"transmission_a{number}\">\n    <type>transmission_interface/SimpleTransmission</type>\n    \
             <joint name=\"joint_a{number}\"/>\n    <actuator name=\"motor_a{number}\"/>\n  </transmission>"
        );
    }
    text.push_str("</robot>\n");
    text
}

/// The links that move, and the tool ball, in `base_link` at axis angles (rad), mm: the rigid arm, as a reader of the URDF has it.
pub(super) fn link_frames(robot: &Robot, axes: &[f64; AXES]) -> Vec<(String, Pose)> {
    let along = |mm: Vector3<f64>| Pose { position: mm, ..Pose::identity() };
    let (mut frame, mut before_mm) = (Pose::identity(), 0.0);
    let mut frames = Vec::with_capacity(AXES + 2);
    for ((row, angle), number) in
        robot.geometry.rows.iter().zip(robot.geometry.coupling.joints(axes)).zip(1..)
    {
        let turned = rot_y(row.beta) * rot_x(row.alpha);
        let rotation = turned * rot_z(row.theta + row.sign * angle);
        let position = Vector3::z() * before_mm + turned.column(0) * row.a;
        frame = frame.then(&Pose { rotation, position });
        frames.push((format!("link_{number}"), frame));
        before_mm = row.d;
    }
    let flange = frame.then(&along(Vector3::z() * before_mm));
    frames.push(("flange".into(), flange));
    frames.push(("ball".into(), flange.then(&along(robot.geometry.tool))));
    frames
}

/// A joint whose variable is not the angle that the controller shows.
pub struct CoupledJoint {
    /// Number of the joint, from 1.
    pub number: usize,
    /// Sum of axes, such as `A3 + A2`.
    pub sum: String,
}

pub fn coupled(robot: &Robot) -> impl Iterator<Item = CoupledJoint> {
    Joint::ALL.into_iter().filter_map(|joint| {
        let number = joint.number();
        Some(CoupledJoint { number, sum: format!("A{number}{}", robot.geometry.coupling.of(joint)?) })
    })
}

/// A link with the masses that move with it; its frame is `d_mm` before the frame of the row.
fn link(robot: &Robot, number: usize, d_mm: f64) -> String {
    let load = &robot.geometry.load;
    let stated =
        load.masses.iter().copied().filter(|_| !load.is_assumed).chain(load.carried().map(Payload::mass));
    let own: Vec<Mass> = stated.filter(|mass| mass.joint.number() == number).collect();
    let kg: f64 = own.iter().map(|mass| mass.kg).sum();
    let (kg, remark) = if kg > 0.0 { (kg, "") } else { (PLACEHOLDER_KG, " <!-- placeholder -->") };
    let centre = own.iter().map(|mass| mass.centre * mass.kg).sum::<Vector3<f64>>() / kg;
    let inertia = own
        .iter()
        .map(|mass| {
            let lever = (mass.centre - centre) * 1e-3;
            (Matrix3::identity() * lever.norm_squared() - lever * lever.transpose()) * mass.kg
        })
        .sum::<Matrix3<f64>>()
        + Matrix3::identity() * PLACEHOLDER_INERTIA_KG_M2;
    let [ixx, ixy, ixz] = [0, 1, 2].map(|column| inertia[(0, column)]);
    format!(
        "  <link name=\"link_{number}\">\n    <inertial>\n      {}\n      <mass value=\"{kg}\"/>{remark}\n      <inertia ixx=\"{ixx}\" ixy=\"{ixy}\" \
         ixz=\"{ixz}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/>\n    </inertial>\n  </link>\n",
        origin_tag(&(centre + Vector3::z() * d_mm), &Matrix3::identity()),
        inertia[(1, 1)],
        inertia[(1, 2)],
        inertia[(2, 2)],
    )
}

/// A link that is fixed on another.
fn fixed(name: &str, parent: &str, place: &Pose) -> String {
    format!(
        "  <joint name=\"{parent}-{name}\" type=\"fixed\">\n    <parent link=\"{parent}\"/>\n    <child link=\"{name}\"/>\n    {}\n  </joint>\n  \
         <link name=\"{name}\"/>\n",
        origin_tag(&place.position, &place.rotation)
    )
}

pub(super) fn origin_tag(place_mm: &Vector3<f64>, rotation: &Matrix3<f64>) -> String {
    let [x, y, z] = [0, 1, 2].map(|axis| place_mm[axis] * 1e-3);
    let [roll, pitch, yaw] = roll_pitch_yaw(rotation);
    format!("<origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"/>")
}

/// R = Rz(yaw) Ry(pitch) Rx(roll). The yaw is removed before the roll is computed, so that the three angles give R to
/// rounding also at a pitch of a right angle.
pub(super) fn roll_pitch_yaw(r: &Matrix3<f64>) -> [f64; 3] {
    let yaw = r[(1, 0)].atan2(r[(0, 0)]);
    let level = rot_z(-yaw) * r;
    [(-level[(1, 2)]).atan2(level[(1, 1)]), (-level[(2, 0)]).atan2(level[(0, 0)]), yaw]
}

/// A name that every reader of URDF accepts.
fn name(words: &str) -> String {
    let plain: String =
        words.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' }).collect();
    let plain = plain.trim_matches('_');
    if plain.is_empty() { "robot".into() } else { plain.into() }
}

/// Text within a comment, which two dashes would end.
fn comment(words: &str) -> String {
    words.replace(|c: char| c.is_control() || "<>-".contains(c), " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::estimation::Workspace;

    /// The same holds for an arm whose third axis is coupled with the second.
    #[test]
    fn the_ball_of_the_links_is_that_of_the_table() {
        for name in ["kr60ha", "m10id12", "ur10e"] {
            let robot = Robot::by_name(name).unwrap().unwrap();
            for axes in Workspace::uniform(&robot, 20, 1) {
                let frames = link_frames(&robot, &axes);
                let [(_, flange), (_, ball)] = &frames[AXES..] else { panic!("{frames:?}") };
                let expected = robot.geometry.flange(&axes);
                assert!(
                    (flange.position - expected.position).norm() < 1e-9 && flange.angle_to(&expected) < 1e-12
                );
                assert!((ball.position - robot.geometry.ball(&axes).position).norm() < 1e-9, "{name}");
            }
        }
    }
}
