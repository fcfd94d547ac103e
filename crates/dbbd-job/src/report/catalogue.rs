//! Pages and exports.

use dbbd_model::findings;

findings! {
    /// A result that cannot be written in the form that was asked for.
    ReportFinding "Pages and exports" {
        E1702 "a record of a capture cannot be exported",
        cause: "A record holds no JSON where it must: the capture is of another version of dbbd, or was edited.",
        cure: "`dbbd recover` writes a capture without its damaged records; export that one." {
            NotJson { record: String, why: String } => "a {record} record is not JSON: {why}";
        }
        E1721 "a URDF is of another robot",
        cause: "With all joints at zero an axis of the URDF is not where the nominal robot has it: the file is of another robot, or its joints have another zero or sense than the controller's axes.",
        cure: "Use the URDF of this robot. Change the zero or the sense of a joint in the URDF to that of the controller." {
            OtherUrdf { joint: String, number: usize, off_mm: f64, off_deg: f64 } => "joint `{joint}` is {off_mm:.1} mm and {off_deg:.2} deg from axis {number} of the nominal robot";
        }
        I1723 "a joint of a URDF turns with two axes",
        cause: "The controller shows an axis that is coupled with another, as a FANUC shows axis 3 against the horizontal. A joint of a URDF has one variable and cannot follow the sum of two.",
        cure: "Give the joint of the URDF the sum that is named, as with the maker's own URDF." {
            CoupledInUrdf { joint: usize, sum: String } => "the variable of the URDF's joint {joint} is {sum}, not what the controller shows for axis {joint}";
        }
        E1724 "a robot is exported for a target, a capture into tables",
        cause: "With a target or a URDF given the first argument is a robot, or the directory of its result. Without them it is a capture.",
        cure: "Give a target or your URDF with a robot, and neither with a capture.",
        asks: [HandBackTarget, Urdf] {
            RobotWithoutTarget => "is a robot, and neither a target nor a URDF is given";
            CaptureAsRobot => "is a capture: a robot is exported for a target or into a URDF, such as robot-identified.toml";
        }
        E1725 "a robot cannot be handed back to this controller",
        cause: "Zeros of axes are differences from the nominal robot, and need the result of its identification (result.json beside robot-identified.toml). Machine data of a KUKA need a KUKA arm with a central wrist.",
        cure: "Give the directory that `dbbd identify` wrote, and the target of the robot's make." {
            NoResult => "the result of this robot's identification is not beside its file";
            NotKuka => "its table is not that of a KUKA with a central wrist";
            OtherMake { robot: String, language: String } => "{robot} has a controller of another make, whose language is {language}";
        }
        W1726 "a file of a hand-back makes the controller worse",
        cause: "An error of an angle and an error of a length are nearly opposite at the tool ball. A controller that takes only one of them is farther from the robot than before.",
        cure: "Enter the files together, or none of them; correct programs with `dbbd compensate`." {
            DoesNotHelp { files: String, before_mm: f64, after_mm: f64 } => "{files} entered without the others: mean error of the tool ball over the workspace {before_mm:.3} -> {after_mm:.3} mm",
                help: "do not enter this";
        }
        I1722 "a target cannot hold all that was identified",
        cause: "A URDF, a DH table and machine data describe rigid links. They cannot represent gear errors, compliance, backlash and smooth joint errors; machine data and zeros hold only a part of the table.",
        cure: "Nothing to do, if the accuracy suffices. Else correct programs with `dbbd compensate`, compute positions with `dbbd predict`, or use joint-errors.csv in your own post-processor." {
            LeftOut { mean_mm: f64, max_mm: f64 } => "left out: {mean_mm:.3} mm at the tool ball on average over the workspace, {max_mm:.3} mm at most";
        }
    }
}
