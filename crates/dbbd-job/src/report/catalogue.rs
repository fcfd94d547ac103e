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
        E1724 "a robot is exported into a URDF, a capture into tables",
        cause: "With a URDF given the joints of a robot are written into your URDF, and the first argument is the robot's file. Without it the first argument is a capture.",
        cure: "Give the URDF with a robot, and leave it out with a capture.",
        asks: [Urdf] {
            RobotWithoutUrdf => "is a robot: it is exported into a URDF, and none is given";
            CaptureIntoUrdf => "is a capture: a robot is exported into a URDF, such as robot-identified.toml";
        }
        I1722 "a URDF cannot hold all that was identified",
        cause: "A URDF describes rigid links. It cannot represent gear errors, compliance, backlash and smooth joint errors.",
        cure: "Nothing to do, if the accuracy suffices; else compute positions with `dbbd predict`, which includes them." {
            NotInUrdf { mean_mm: f64, max_mm: f64 } => "the URDF leaves out joint errors and compliance: {mean_mm:.3} mm at the tool ball on average, {max_mm:.3} mm at most, without backlash";
        }
    }
}
