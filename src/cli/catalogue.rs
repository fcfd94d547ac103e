//! The command line.

use dbbd_model::findings;

findings! {
    /// Arguments that cannot be followed.
    CliFinding "The command line" {
        E0001 "a code is not in the catalogue",
        cause: "The code is mistyped, or it is of another version of dbbd.",
        cure: "`dbbd explain` without a code lists all of them." {
            UnknownCode { code: String } => "there is no code {code}";
        }
        E0003 "an option's value is not valid",
        cause: "The value of an option on the command line is not of its type or out of its range (exit code 2).",
        cure: "`dbbd VERB --help` says what the option takes, with the unit." {
            NotANumber { range: String } => "a number without its unit is needed; {range}";
            NotPositive => "a positive number is needed";
            NotDraws { least: usize, most: usize } => "a number of draws from {least} to {most}, or 0, is needed";
            NotSeconds => "a number of seconds, 0 or more, is needed";
            NotNameAndValue => "must be NAME=VALUE";
        }
        E1982 "an input has no effect here",
        cause: "The input applies only to others: a robot to results and to factory calibrations, the repeatability of a test to circles, a risk with a tolerance, joints to a URDF.",
        cure: "Leave it out, or give the inputs that it applies to.",
        asks: [Robot, CircleRepeatability, Risk, Tolerance, UrdfJoints] {
            Unused { option: &'static str } => "{option} has no effect on these inputs";
        }
    }
}
