//! Robot files, robots, axis angles, and the names of parameters.

use crate::findings;

findings! {
    /// A robot or a parameter that cannot be used.
    RobotFinding "Robots" {
        E0501 "a word is not a parameter",
        cause: "A list of parameters holds a word that is not a parameter, group or range, or a range whose numbers are no parameters.",
        cure: "The parameters are alpha0..5, a0..5, theta1..6, d1..6, beta1..5, tool_x/_y/_z, target<k>_x/_y/_z of further targets, centre<k>_x/_y/_z, bar_offset (bar_offset2, .. of further bars), tracker_x/_y/_z, tracker_rx/_ry/_rz, compliance2..5, payload_compliance2..5, gear1..6_cos/_sin; the groups geometric, tool, targets, centres, bar, tracker, all, compliance, gear; a range is written alpha1-5." {
            UnknownParameter { word: String } => "`{word}` is not a parameter", help: "names such as alpha1 or centre1_x; ranges such as alpha1-5; groups: geometric, tool, targets, centres, bar, tracker, all, compliance, gear";
        }
        E0502 "a parameter is about a ball, bar, target or tracker that the data do not have",
        cause: "The number in the name is higher than that of the last base ball, bar or target, or there is no position of a tracker.",
        cure: "Give a number that occurs in the column `centre`, `bar` or `target` of the measurements." {
            NoSuchBall { name: String, balls: usize } => "`{name}` is not a parameter: the data have {balls} base ball(s)";
            NoSuchBar { name: String, bars: usize } => "`{name}` is not a parameter: the data have {bars} bar(s)";
            NoSuchTarget { name: String, targets: usize } => "`{name}` is not a parameter: the data have {targets} target(s)";
            NoTracker { name: String } => "`{name}` is not a parameter: the data have no position of a tracker";
        }
        E0503 "a robot is not known",
        cause: "The name is not that of a built-in robot, and there is no such file.",
        cure: "`dbbd robots` lists the built-in robots. The name of a robot file ends in .toml." {
            NoSuchRobot { name: String, meant: String, built_in: String } => "no robot `{name}`: neither built in nor a file", help: "{meant}built in are: {built_in}; a file ends in .toml";
        }
        E0504 "a robot file describes an arm that is not modelled",
        cause: "Only arms with six rotary joints in a modified-DH table (Craig) are modelled.",
        cure: "Convert the table to modified DH; `dbbd robots show kr60ha` is an example. An arm with fewer or more joints cannot be calibrated here." {
            Convention { convention: String } => "convention `{convention}` is not known: only `modified-dh` is";
            JointCount { robot: String, joints: usize, needed: String } => "{robot} has {joints} [[joint]] tables: a robot here has six rotary joints", help: "{needed}";
        }
        E0505 "values of a robot file contradict each other",
        cause: "A sign or a number of a joint is none, two values exclude each other, or a table that dbbd wrote was changed.",
        cure: "Correct the value that is named; take tables that dbbd wrote as they were." {
            JointSign { joint: usize, sign: i8 } => "joint {joint}: sign = {sign} must be 1 or -1";
            JointLimits { joint: usize, low_deg: f64, high_deg: f64 } => "joint {joint}: limits_deg = [{low_deg}, {high_deg}] must be [low, high], within 100000 degrees";
            Coupling { joint: usize, axis: usize, factor: i8 } => "joint {joint}: coupling with axis = {axis} and factor = {factor}: axis must be 2 to {joint} - 1, factor 1 or -1";
            NoCoupledAngle { joint: usize, axis: usize, axis_deg: f64 } => "joint {joint}: limits_deg and those of coupling leave axis {joint} no angle where axis {axis} is at its limit of {axis_deg} degrees";
            Posterior => "[posterior]: `values` and the rows of `root`, which are 1, 2, .. numbers long, must be as many as `parameters` of the robot, each there once";
            NotADate { date: String } => "date = \"{date}\" is not a date YYYY-MM-DD";
            Drift => "[drift]: `zero_rad` must be above 0 and at most 0.01 rad, `ln_sd` 0 to 2";
            NoName => "name is empty: runs and programs are compared by it";
            PayloadTwice { name: String } => "[[payload]]: `{name}` is there twice: rows of measurements name one of several";
            PayloadUncertainty { kg: f64, u_kg: f64 } => "[[payload]]: u_kg = {u_kg} is more than the mass of {kg} kg", help: "is it in grams?";
            Gravity => "[mounting] gravity must be the direction of gravity in the robot base, as [0, 0, -1] for an arm on the floor";
            GravityOfMounting { down: [f64; 3] } => "[mounting] gravity is not that of abc_deg, with which it is {down:?}", help: "leave gravity out";
            ControllerRows { rows: usize, needed: usize } => "[controller] has {rows} [[controller.joint]] tables: model = \"calibrated\" needs 6, another model none (here {needed})";
            ControllerOfIdentified => "[controller] of an identified robot belongs to its nominal one: write it as [nominal.controller]";
            MassJoint { joint: usize } => "[[mass]]: joint = {joint} must be 1 to 6";
            Uncertainty => "[uncertainty] does not fit the robot: a row of `root` for each of `parameters` and each coefficient of the joints, all of one length";
        }
        E0582 "a payload is not known",
        cause: "The name is not that of a [[payload]] of the robot file. A command takes KG,X,Y,Z in place of a name, a table does not.",
        cure: "Name a payload of the robot file, add one to it, or give a command the mass in kg and the centre in the flange frame in mm." {
            PayloadOfRow { index: u32, name: String, known: String } => "index {index}: `{name}` is not a [[payload]] of the robot file: {known}";
            NoSuchPayload { asked: String, known: String } => "`{asked}` is neither KG,X,Y,Z nor a [[payload]] of the robot file: {known}";
        }
        W0583 "a payload was never measured",
        cause: "The robot was identified with a lighter payload. How far its joints give way under this one follows from the weight of the arm, whose masses are known roughly.",
        cure: "Measure the same poses once more with this payload and name both payloads in the column `payload`; the stated uncertainty then falls." {
            PayloadNeverMeasured { kg: f64, measured_kg: f64 } => "a payload of {kg:.1} kg was never measured: the heaviest was {measured_kg:.1} kg";
            NoPayloadMeasured { kg: f64 } => "a payload of {kg:.1} kg was never measured: the robot was identified without one";
        }
        W0584 "a day is before the calibration, or long after it",
        cause: "The day is of another year, or the robot file of another calibration. Beyond ten years nothing is known of a drift.",
        cure: "Correct the date, or take the robot file of that time." {
            BeforeCalibration { day: String, measured: String } => "{day} is before {measured}, the day of the calibration";
            LongAfterCalibration { day: String, measured: String, years: f64 } => "{day} is {years:.1} years after {measured}, the day of the calibration: a drift is known for ten";
        }
        W0581 "a robot file has the name of a built-in robot and another table",
        cause: "The table was copied and edited, or a value is in another unit or has another sign. Files of plans and results are compared by the robot's name.",
        cure: "Correct the value that is named, or give the robot a name of its own." {
            UnlikeBuiltIn { robot: String, joint: usize, key: &'static str, value: f64, built_in: f64 } => "joint {joint}: {key} is {value}, and the built-in `{robot}` has {built_in}";
        }
        E0507 "nobody has stated where the tool ball is",
        cause: "Neither the robot file nor the job has [tool] ball_mm, the place of the ball on the tool in the frame of the flange. Programs would be driven and lengths computed with another tool than yours.",
        cure: "Measure it from the flange, X, Y and Z in mm, and state it in the job: [tool] ball_mm = [30.0, 20.0, 10.0]. A few tenths of a millimetre are enough, the lengths determine the rest; [tool] ball_u_mm says how well it is known (0.5 mm). A ball in the middle of the flange is [0.0, 0.0, 0.0].",
        asks: [ToolBall] {
            NoToolBall { robot: String } => "nobody has stated where the tool ball of `{robot}` is: state [tool] ball_mm, in mm from the flange";
        }
        E0506 "a pose has no axis angles",
        cause: "The pose is beyond the arm, or only another branch or turn of the axes reaches it.",
        cure: "Move the pose nearer to the robot, or give it a status and turn that the arm can take there." {
            OutOfReach => "the pose is out of reach";
            NotConverged { distance_mm: f64 } => "no axis angles found: still {distance_mm:.3} mm away after the last iteration";
            NoSuchQuadrants { wanted: String } => "no axis angles within the limits have the configuration {wanted}";
            NoSuchConfiguration { status: u8, turn: u8 } => "no axis angles within the limits have S {status}, T {turn}";
        }
        I0510 "the repeatability of a robot is not known",
        cause: "The robot file has no `repeatability_mm`, so the noise of a length is taken for that of the bar alone until many lengths show more.",
        cure: "Add `repeatability_mm` to the robot file: RP by ISO 9283 from the maker's data sheet." {
            NoRepeatability { robot: String } => "{robot}: its file has no repeatability_mm, and no length is better than the repeatability of the robot";
        }
    }
}
