//! Comparison of results and interim checks.

use crate::diagnostic::Names;
use crate::findings;

findings! {
    /// What a comparison or an interim check refuses, warns of or notes.
    ConformityFinding "Comparison and interim check" {
        E1902 "results are not of one robot",
        cause: "The results are of robots with other names or nominal values, or a circular test is among calibrations, or no circle of one radius is in all tests. Differences between them are not changes of a robot.",
        cure: "Compare results of one robot, of one kind, in one unit." {
            OtherKind { first: String } => "is of another kind than {first}";
            OtherRobot { first: String, robot: String, other: String } => "is of `{other}`, {first} of `{robot}`";
            OtherNominal { first: String, parameter: String, value: f64, other: f64 } => "has the nominal {parameter} {other}; {first} has {value}";
            OtherUnit { parameter: String, unit: String, given: String } => "has {parameter} in `{given}`, not in {unit}";
            NothingInCommon { first: String } => "has nothing that can be compared with {first}";
        }
        E1903 "a result is given twice",
        cause: "Two of the files have the same content: a calibration cannot be compared with itself.",
        cure: "Leave one out." {
            Twice { first: String } => "is the same result as {first}";
        }
        E1904 "the dates do not fit the results",
        cause: "There must be one date YYYY-MM-DD for each result, in the order of the results, each after the one before.",
        cure: "Write 2025-03-01,2025-06-01 for two results, oldest first.",
        asks: [Dates] {
            DateCount { dates: usize, results: usize } => "{dates} dates are given for {results} results";
            NotADate { date: String } => "`{date}` is not a date YYYY-MM-DD";
            FutureDate { date: String } => "{date} is in the future, by the clock of this computer";
            NotAfter { date: String, before: String } => "{date} is not after {before}";
        }
        W1907 "dates contradict the results",
        cause: "The date given is another day than the measurement of the result states, or a result was measured before the one that is given before it, by the computer's clock.",
        cure: "Correct the dates, or leave them out where trends per result suffice. Give the results oldest first; check the clock of the computer.",
        asks: [Dates] {
            MeasuredBefore { measured: String, before: String } => "was measured on {measured}, and the result before it on {before}";
            OtherDate { date: String, measured: String } => "was measured on {measured}, and the date given is {date}";
        }
        E1905 "the robot of a result is not known",
        cause: "The change of the position needs the robot's axes and limits, which robot-identified.toml beside result.json has.",
        cure: "Keep robot-identified.toml beside result.json, or give the robot.",
        asks: [Robot] {
            NoRobotBeside { looked_for: String } => "there is no {looked_for} beside it";
        }
        I1906 "the results estimate different parameters",
        cause: "A parameter was estimated in one result and not in another one. What was not estimated acts on the others, so that their changes need not be changes of the robot.",
        cure: "Identify all results with the same options from like poses." {
            DifferentlyEstimated { parameters: Names } => "{parameters} are not estimated in all results and are not compared";
        }
        I1927 "positions are compared by parameters alone",
        cause: "The robot-identified.toml of a compared result is not beside it, or it is of another calibration. Errors of the joints and the uncertainty are then not known, and the difference of the positions need not be a change of the robot.",
        cure: "Keep robot-identified.toml beside result.json." {
            PositionByParameters { results: Names } => "the position is compared by the parameters alone, without uncertainty: no robot-identified.toml of their own is beside {results}";
        }
        E1910 "the robot cannot be checked",
        cause: "A check compares with what the calibration left unknown, the table [posterior] of robot-identified.toml. The file has none, its values were changed since, or it is the file of another robot than the plan's.",
        cure: "Give the robot-identified.toml of this robot as `dbbd identify` wrote it. A file of an earlier version: identify again from its lengths.",
        asks: [Robot] {
            NoPosterior { robot: String } => "`{robot}` has no [posterior]: it is not an identified robot, or an earlier version wrote its file";
            PosteriorOfAnother { robot: String } => "the [posterior] of `{robot}` is of other values than the robot's";
            PlanOfAnother { planned: String, given: String } => "the run is of a plan for {planned}, and the robot given is {given}";
        }
        E1911 "the lengths do not suffice for a check",
        cause: "Three lengths place each base ball; fewer than four beyond these contain almost no information about a change.",
        cure: "Measure more poses: 12 to 24 to one ball." {
            TooFewLengths { lengths: usize, least: usize } => "{lengths} lengths, at least {least} are needed to so many base balls";
        }
        E1912 "the noise of the lengths is not known",
        cause: "A check compares with noise and repeatability. The lengths have no sigma_mm, the robot no repeatability_mm, and no result.json is beside the robot.",
        cure: "Give the standard deviation of a length with the robot's repeatability in it.",
        asks: [Sigma] {
            NoNoise => "neither sigma_mm nor the robot's repeatability is known", help: "give the standard deviation of a length";
        }
        E1913 "a check cannot be computed",
        cause: "A number is impossible: an angle, a length, a base ball or a value of the posterior.",
        cure: "Check lengths, base balls and robot file." {
            NotFinite => "a number is not finite";
        }
        E1923 "a base ball is not where the calibration had it",
        cause: "The base balls are stated to be mounted as in the calibration. The robot file does not have their places (they were fixed in the calibration, or an earlier version wrote the file), or the place given is more than 50 mm, in a plan more than the stroke, from the calibration's.",
        cure: "Do not state it: the base balls then count as mounted again. To have their places in the file, identify again from the lengths of the calibration.",
        asks: [BallsKept] {
            BallUnknown { ball: u32 } => "the [posterior] of the robot file has no place of base ball {ball}";
            BallElsewhere { ball: u32, away_mm: f64 } => "base ball {ball} is given {away_mm:.0} mm from where the calibration had it";
        }
        I1924 "a base ball that moved is not tested",
        cause: "The base balls count as mounted again, so that each may be anywhere, and the lengths place them. A ball that moved is then no change, nor are the zero of axis 1 and the height of the base, which it carries.",
        cure: "Where the base balls stayed as in the calibration, state so.",
        asks: [BallsKept] {
            BallsNotTested => "the base balls count as mounted again: whether one moved is not tested";
        }
        W1914 "no check can decide",
        cause: "Even if all lengths agreed with the calibrated robot, what remains unknown of its position would be larger than the tolerance: by the calibration, the bar's noise, or too few poses.",
        cure: "Check with more poses or a better bar, calibrate again from more lengths, or state a tolerance that can be decided." {
            Undecidable { tolerance_mm: f64, best_mm: f64 } => "undecidable with this bar and these poses: at best {best_mm:.3} mm can be decided, not {tolerance_mm} mm";
        }
        W1915 "conformity is undecided",
        cause: "The tolerance lies within the uncertainty of the position, so that neither pass nor fail has the risk allowed.",
        cure: "Measure more poses, identify what changed, calibrate again, or accept a larger risk.",
        asks: [Update, Risk] {
            Undecided { tolerance_mm: f64, position_error_mm: f64, risk: f64 } => "undecided: the median of the position error is {position_error_mm:.3} mm; it exceeds {tolerance_mm} mm with probability {risk:.2}";
        }
        W1916 "no single change explains the lengths",
        cause: "More than two parameters changed, the lengths are those of another robot or tool, the bar slipped, or single lengths are wrong. No updated robot file is then written.",
        cure: "Repeat the check. If it stays, calibrate again.",
        asks: [Update] {
            NotExplained { p: f64 } => "something changed (p {p:.1e}), but no change of one or two parameters explains the lengths";
        }
        W1926 "the lengths are of no change of this robot",
        cause: "The most likely change is one of a length or an angle between axes that no robot undergoes; or none explains the lengths, and they fit worse than a robot as its maker promises could. They are of another robot or with another tool ball, or lengths and poses do not belong together. The check then decides nothing.",
        cure: "Check the robot, the tool ball, the plan and the base balls, and measure again. After a crash identify again.",
        asks: [Robot, ToolBall] {
            ImpossibleChange { parameters: Names, times: f64 } => "the most likely change of {parameters} is more than {times:.0} times the robot's tolerance: another robot or tool?";
            AnotherRobot { residual_rms_mm: f64, predicted_max_mm: f64 } => "the lengths fit only to {residual_rms_mm:.1} mm, and the nominal robot is predicted to be off by at most {predicted_max_mm:.1} mm: another robot or tool?";
        }
        W1918 "a robot is checked by the lengths that identified it",
        cause: "Most of the lengths are in the lengths.csv beside the robot's file: they agree with it by construction.",
        cure: "Measure new lengths." {
            LengthsOfCalibration { known: usize, lengths: usize } => "{known} of {lengths} lengths identified this robot: they are no check of it";
        }
        W1925 "the robot was driven to where the nominal robot would be",
        cause: "The lengths agree with the nominal robot and not with the identified one: the program of the check was corrected, or the controller computes with a calibrated model of its own. The robot need not have changed.",
        cure: "Run the program of the check as it was written, and in the mode of the calibration.",
        asks: [LoggedAxes] {
            DrivenAsNominal { rms_mm: f64 } => "the lengths agree with the nominal robot to {rms_mm:.3} mm: was a corrected program run?";
        }
        W1921 "the lengths agree too well",
        cause: "The lengths agree with the robot far better than their standard deviation allows: sigma is too large (the column sigma_mm, the one given, repeatability_mm of the robot file), or the lengths were computed. A check with too large a sigma finds no change.",
        cure: "Give the standard deviation that the lengths have, and measured lengths.",
        asks: [Sigma] {
            TooGood { chi_square: f64, freedom: usize } => "chi-square {chi_square:.2} of {freedom} degrees of freedom: the lengths agree far better than their standard deviation";
        }
        W1922 "the result beside the robot file is of another calibration",
        cause: "Files of several calibrations were put into one directory, so that result.json does not belong to robot-identified.toml. The model error of the calibration is then not known and can look like a change.",
        cure: "Put result.json and robot-identified.toml of one calibration beside each other, or give the standard deviation of a length.",
        asks: [Sigma] {
            OtherResultBeside { looked_for: String, sigma_mm: f64 } => "{looked_for} is of another calibration: a length counts with {sigma_mm:.4} mm, of bar and repeatability alone";
        }
        W1908 "circles that are compared are not alike",
        cause: "The files do not match: one is an arc and the other a full circle, whose quantities differ by that alone, or both were made from the same lengths, so there is no change to see.",
        cure: "Compare tests of the same circle that were measured one after the other." {
            ArcAndCircle { file: String, span_deg: f64, first: String, first_deg: f64 } => "{file} covers {span_deg:.0} degrees, and {first} {first_deg:.0}";
            SameLengths { file: String, first: String } => "{file} is made from the same lengths as {first}";
        }
        I1920 "the model error of the calibration is not known",
        cause: "The result.json of the calibration is not beside the robot file, so that the standard deviation of a length is that of bar and repeatability alone. Model errors can then look like a change.",
        cure: "Keep result.json beside robot-identified.toml, or give the standard deviation of a length.",
        asks: [Sigma] {
            NoResultBeside { looked_for: String, sigma_mm: f64 } => "{looked_for} is not there: a length counts with {sigma_mm:.4} mm, of bar and repeatability alone";
        }
        I1917 "there is nothing to update",
        cause: "The test finds no change; the robot file holds.",
        cure: "Nothing." {
            NothingToUpdate => "nothing changed: no robot file is written";
        }
    }
}
