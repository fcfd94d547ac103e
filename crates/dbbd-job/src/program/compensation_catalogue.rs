//! Correcting a program for an identified robot.

use dbbd_model::findings;

findings! {
    /// A program that cannot be corrected, or a part of it that stays as it is.
    CompensationFinding "Correcting a program" {
        E0901 "a frame is not known at a motion",
        cause: "The correction of a point depends on its frames, and these are set elsewhere, computed, or differ between the ways through the program; or the controller displaces or corrects the motion itself.",
        cure: "Give the controller's $config.dat, or tool and base; or set both frames in the program before the motion.",
        asks: [ControllerConfig, ToolFrame, BaseFrame] {
            FrameNotSet { frame: &'static str } => "nothing sets {frame} before this",
                help: "set it in the program, or give it; in KRL $config.dat gives all";
            FrameComputed { frame: &'static str, line: usize } => "{frame} is computed in line {line}";
            FramePart { frame: &'static str, line: usize } => "line {line} sets a part of {frame}";
            FrameMixed { frame: &'static str, first: String, second: String } => "{frame} is the one {first} or the one {second}, by the way on which the program comes here",
                help: "set it again before this motion";
            FrameBeside { frame: &'static str, line: usize } => "line {line} sets {frame} in a routine that runs beside the program",
                help: "let the program itself set it before each motion";
            FrameElsewhere { frame: &'static str, name: String } => "{frame} is {name}, which is in no file given",
                help: "give the file with the controller's tools and frames, or tool and base";
            FramesInLoop => "this motion has different frames when the loop repeats", help: "set $TOOL and $BASE at the start of the loop";
            RootSet { line: usize } => "line {line} moves the robot away from the origin of $BASE ($ROBROOT)", help: "put the place of the robot into $BASE";
            MovedWorkObject { name: String } => "{name} is moved by a mechanical unit";
            Displaced { word: String, line: usize } => "{word} in line {line} displaces this motion", help: "put the displacement into the work object";
            OptionUnknown { word: String, line: usize } => "whether the option {word} in line {line} displaces this motion is not known";
            FixedTool { name: String } => "{name} moves the workpiece against a fixed tool",
                help: "only a tool on the flange can be compensated";
        }
        E0915 "a frame or the points are in another unit",
        cause: "X, Y and Z of a tool, a base or most points are in metres where millimetres are needed, or the other way round.",
        cure: "Give frames and points in mm (in URScript in m)." {
            PointsInMetres { points: usize, size_mm: f64 } => "{points} points are within {size_mm:.3} mm of the origin of their frame: are they in metres?";
            FrameInOtherUnit { frame: &'static str, size_mm: f64 } => "{frame} is {size_mm:.3} mm away: is it in another unit?";
        }
        W0916 "an external axis is not at 0",
        cause: "Points of the program have a rail or a positioner elsewhere than at 0. The model of the robot does not have this axis: the points are corrected as if robot and work stood where they stand at 0.",
        cure: "Check the corrected points, or correct one program for each position of the external axis, with the base as the robot has it there." {
            ExternalAxis { axis: usize, name: String, at: f64 } => "external axis {axis} is at {at} at {name}: the points are corrected as if it were at 0";
        }
        E0922 "the controller corrects the program by itself",
        cause: "The program switches on the absolute accuracy of the controller, which then corrects each pose by its own model: a corrected point would be corrected twice.",
        cure: "Switch absolute accuracy off in the program, identify the robot with it off, and correct again; or leave the program to the controller." {
            ControllerCorrectsTaught { name: String } => "{name} was taught with the controller's own correction, which the robot file has: the controller corrects this point itself";
            ControllerCorrects { line: usize } => "line {line} switches absolute accuracy on: the controller corrects this point itself";
        }
        W0926 "points were taught under absolute accuracy",
        cause: "Bit 4 of their S says that the controller corrected the arm by a model of its own when they were taught. If it does so when the program runs, a corrected point is corrected twice; no line of the program says whether it does.",
        cure: "Look into the controller's absolute accuracy. If it is on, leave the program to the controller, or identify the robot with it off and run the program with it off." {
            TaughtUnderAccuracy { points: usize, name: String } => "{points} points were taught with the controller's own correction, {name} first";
        }
        W0921 "a routine of another file may change a frame",
        cause: "The program calls a routine that is not in its file between setting a frame and a motion with it, or gives it a tool or a work object. The correction takes it that the frame stays what it was.",
        cure: "Look whether the routine changes the frame. If so, set the frame after the call and correct again." {
            FrameAfterCall { frame: &'static str, routine: String, line: usize } => "{routine}, called in line {line}, is taken not to change {frame}";
            FrameGivenAway { name: String, routine: String } => "{routine} is given {name}, and is taken not to change it";
        }
        E0902 "the tool or the base that is given contradicts the program",
        cause: "The program sets the frame to another value, or uses several frames that it does not define.",
        cure: "Leave the frame out, correct it, or give $config.dat in its place.",
        asks: [ToolFrame, BaseFrame, ControllerConfig] {
            FrameDiffers { frame: &'static str, stated: &'static str } => "the program sets {frame} itself, and not to the value of {stated}";
            TwoFrames { stated: &'static str, first: String, second: String } => "{stated} would stand for two frames: {first}, and elsewhere {second}";
        }
        E0903 "a point has no fixed value",
        cause: "The point is computed while the program runs, a component of it is missing, or its quaternion is not of unit length.",
        cure: "Write the point with all components as taught, and in KRL its frame as $BASE." {
            PointComputed { name: String, line: usize } => "{name} is computed in line {line}";
            PointExpression => "a motion to a point that is computed cannot be compensated";
            PointIncomplete { name: String, why: String } => "{name}: {why}";
            PointNorm { name: String, norm: f64 } => "{name}: the quaternion is of length {norm:.3}, not 1", help: "teach the point again, or correct its components";
            PointShape { numbers: usize } => "the point is not written as a list with {numbers} numbers where they are needed";
        }
        E0904 "a point is used with two tools or bases",
        cause: "The correction depends on the frames, so that one point would need two corrections.",
        cure: "Give each use a point of its own." {
            PointTwice { name: String, line: usize } => "{name} is used with another tool or base in line {line}";
        }
        W0905 "a motion stays as it is",
        cause: "Its point or one of its frames is computed or not known, it is relative and starts from a corrected point, its point is declared in a file that is not rewritten, another instruction or a routine of the user's own moves there, or an instruction displaces it.",
        cure: "Check that the place does not matter, or teach the point in the program's own .dat." {
            MotionLeft { why: String } => "this motion stays as it is: {why}";
            PointShared { name: String, line: usize } => "{name} stays as it is: the motion in line {line} uses it too, and stays as it is";
            RelativeMotion => "a relative motion stays as it is: it starts from a corrected point";
            PointInStatement { name: String } => "{name} stays as it is: this statement is not a known KRL motion";
            PointOfOtherCall { name: String, call: String } => "{name} stays as it is: {call} is not a motion that is corrected";
            NotRead { word: String } => "a motion by {word} stays as it is: its point is not in the statement";
            Displacing { word: String } => "{word} displaces the motions after it: their points are corrected without the displacement";
            NeverReached => "this motion stays as it is: no way of the program leads to it";
            PointElsewhere { name: String } => "{name} stays as it is: it has no fixed value in the program's files";
        }
        E0906 "a robot does not reach a point",
        cause: "The point, with the tool and base given, is out of reach of the nominal or of the identified robot, or beyond an axis limit.",
        cure: "Check tool, base and the robot file; teach the point further inside.",
        asks: [ToolFrame, BaseFrame] {
            NominalDoesNotReach { why: String } => "the nominal robot does not reach it: {why}";
            IdentifiedDoesNotReach { why: String } => "the identified robot does not reach it: {why}";
            BeyondLimit { axis: usize, angle_deg: f64, low_deg: f64, high_deg: f64 } =>
                "axis {axis} would leave its limits: {angle_deg:.3} deg of {low_deg} to {high_deg}";
            StatusOutOfRange => "S or T is out of range";
        }
        E0923 "the configuration of a point selects no branch",
        cause: "The point is a pose, which an arm reaches in several branches, and nothing in the program selects one: the program begins with this point, without S and T in KRL or qnear in URScript. Or a FANUC's point has no CONFIG, or the arm is one whose wrist axes do not meet (CRX): how CONFIG counts there is not known.",
        cure: "Say where the robot stands before the program, or begin the program with a motion to axis angles in the branch of the point; for a FANUC write the point as axis angles (J1 to J6).",
        asks: [StartAxes] {
            NoBranchBefore => "no motion before this pose selects the branch in which the arm reaches it";
            NoFanucRule => "what CONFIG means for this arm is not known";
            NoFanucConfiguration { name: String } => "{name} has no CONFIG that can be read";
        }
        E0907 "a point is too near to a singularity",
        cause: "A small correction of the pose turns an axis far, or changes the branch of the arm.",
        cure: "Teach the point further away from the singularity, or go there by LIN." {
            LargeTurn { axis: usize, turn_deg: f64 } => "axis {axis} would have to turn by {turn_deg:.1} deg";
            SharedConfiguration => "it would need another configuration than the named one, which other points may use";
            OtherStatus { taught: u8, corrected: u8 } => "it would need S {corrected} in place of S {taught}";
        }
        E0908 "a correction is larger than its limit",
        cause: "The program is of another robot or cell than the identified one, or the identification is wrong.",
        cure: "Check that program, frames and robot file belong together; raise the limit only if you know that the robot is off by that much.",
        asks: [Limit] {
            TooFar { shift_mm: f64, limit_mm: f64 } => "it would move by {shift_mm:.3} mm, allowed are {limit_mm:.3}";
        }
        E0909 "the robot file is not of an identified robot",
        cause: "The file has no [nominal] table: it is a nominal robot, as built-in robots are.",
        cure: "Give the robot-identified.toml that `dbbd identify` wrote, or its directory.",
        asks: [Robot] {
            NotIdentified => "the robot is not an identified one";
        }
        E0980 "a program is cut off",
        cause: "The file ends before the routine or the data list does: a copy broke off, or it was cut by an editor.",
        cure: "Fetch the file from the controller again." {
            CutOff { end: String } => "the file has no {end}: it is cut off";
        }
        E0910 "the arguments of compensate do not fit",
        cause: "The program named is a .dat file, the results would replace the program, or a frame or a start is not six numbers, or not of this robot.",
        cure: "Name the .src, another directory for the results, frames in mm and degrees, and a start in degrees.",
        asks: [Out, ToolFrame, BaseFrame, ControllerConfig] {
            DataNamed => "the file contains the points of a program but no motion", help: "name the .src; the .dat beside it is corrected with it";
            WouldOverwrite { directory: String } => "writing into {directory} would overwrite the program itself";
            FrameUnused { language: &'static str } => "a program in {language} does not take these frames",
                help: "in RAPID a module with tools and work objects is given, in URScript the TCP as the tool, for a FANUC SYSFRAME.VA, or tool and base";
            NotAFrame => "six numbers in mm and degrees are needed, as 0,0,150,0,0,0";
            NotAxisAngles => "six axis angles in degrees are needed, as 0,-90,90,0,30,0";
            StartBeyondLimit { axis: usize, angle_deg: f64, low_deg: f64, high_deg: f64 } =>
                "the start has axis {axis} at {angle_deg} deg, beyond its limits of {low_deg} and {high_deg}";
        }
        I0911 "an axis passes zero",
        cause: "The correction moves an axis to the other side of zero, so that the point needs another turn bit.",
        cure: "Nothing to do: the bit is corrected." {
            TurnChanged { name: String, line: usize, taught: u8, corrected: u8 } => "line {line}: {name}: T {taught} became T {corrected}";
        }
        E0912 "a program is not corrected",
        cause: "At least one of its points cannot be corrected; each is listed with its own code. Nothing is written.",
        cure: "Correct the points listed." {
            PointsRefused { points: usize } => "{points} point(s) cannot be compensated; nothing is written";
        }
        E0913 "a file is not a program in its language",
        cause: "The file has no routine (DEF NAME ( ) .. END of KRL, MODULE .. ENDMODULE of RAPID, def name(): .. end of URScript, /PROG .. /MN of a TP program): it is a program in another language than its extension says, or a table.",
        cure: "Name the .src of a KUKA program, the .mod of an ABB, the .script of a Universal Robots or the .ls of a FANUC program. Programs in other languages are not corrected." {
            NotRapid { begins: String } => "is not a module in RAPID: it begins with `{begins}`";
            NotFanuc { begins: String } => "is not a TP program: it begins with `{begins}`";
            NotUrscript { begins: String } => "is not a program in URScript: it begins with `{begins}`";
            NoLanguage { file: String } => "{file} is in no language that is known by its extension", help: ".src is KRL, .mod RAPID, .script URScript, .ls a FANUC TP program; PolyScope saves the .script of a program beside its .urp";
            NotKrl { begins: String } => "is not a program in KRL: it begins with `{begins}`";
        }
        E0917 "the controller corrects with a table that is not known",
        cause: "Every controller of this make holds a factory calibration of its arm and computes axis angles with it. A correction against the nominal table would be added to the controller's own.",
        cure: "Import the controller's table with `dbbd robots import`, plan and identify with that robot; or say that the controller has the nominal table.",
        asks: [ControllerModel] {
            ControllerUnknown { robot: String } => "{robot}: [controller] model = \"unknown\": with which table the controller computes is not known";
            ControllerCalibrated => "the robot file has the controller's table: the nominal table cannot be meant as well", help: "leave the option out, or take the file of another robot";
        }
        E0924 "it is not known how the bar of a program is mounted",
        cause: "The program is that of a plan and moves the bar. A corrected program moves about the base balls as they are mounted: for that the plan is needed, with the axis angles at which each ball was taught.",
        cure: "Keep plan.csv and plan.json in a directory beside the program, or name the plan. State `taught_deg` of each ball in the job, and plan again.",
        asks: [Plan] {
            NoPlanBeside { plan: String } => "the program holds the bar of plan {plan}, which is not in a directory beside it";
            OtherPlan { plan: String, given: String } => "the program is of plan {plan}, and {given} is given";
            BallNotTaught { ball: u32 } => "base ball {ball} of the plan has no taught_deg, and the robot was not identified with it: where it is mounted is not known";
        }
        E0925 "a corrected program leaves the stroke of the bar",
        cause: "At this row of the plan the bar would be longer or shorter than its stroke allows: the tool ball is not where the controller has it.",
        cure: "Plan again with the identified robot, or with a bar of a longer stroke. Do not run the program with the bar mounted." {
            LeavesStroke { row: u32, reading_mm: f64, low_mm: f64, high_mm: f64 } => "row {row} of the plan: the reading would be {reading_mm:.3} mm, and the stroke is {low_mm} to {high_mm} mm";
        }
        W0918 "a correction does not make the program better",
        cause: "What the identification leaves unknown is as large as the correction, at the points and with the tool of this program.",
        cure: "Measure more poses near these points (`dbbd identify` proposes some), then correct the program again." {
            NoBetter { before_mm: f64, after_mm: f64 } => "the predicted position uncertainty of the tool is {after_mm:.3} mm with the correction and {before_mm:.3} mm without it";
        }
        W0914 "no point was corrected",
        cause: "The program has no motion to a point in its own .src or .dat.",
        cure: "Name the program that holds the points, with its .dat beside it." {
            NothingCorrected => "no point was corrected: the program has none of its own";
        }
    }
}
