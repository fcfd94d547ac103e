//! Comparison of results and interim checks.

use super::{Names, findings};

findings! {
    /// What a comparison or an interim check refuses, doubts or notes.
    ConformityFinding {
        E1901 "a file is no result that can be compared",
        cause: "The file is not the result.json of `dbbd identify` nor the circle.json of `dbbd circle`, or another version of dbbd wrote it.",
        cure: "Give result.json or circle.json, or the directory that holds one. Make a result of another version anew from its lengths." {
            NotJson { why: String } => "is no JSON: {why}";
            NeitherResultNorCircle => "is neither a result.json nor a circle.json";
            OtherSchema { schema: String, known: u32 } => "has schema {schema}, known is {known}";
            Incomplete { why: String } => "is not complete: {why}";
            NoFileInDirectory => "holds neither result.json nor circle.json";
        }
        E1902 "results are not of one robot",
        cause: "The results are of robots with other names or nominal values, or a circular test is among calibrations, or no circle of one radius is in all tests. Then no difference is a change.",
        cure: "Compare results of one robot, of one kind, in one unit." {
            OtherKind { first: String } => "is of another kind than {first}";
            OtherRobot { first: String, robot: String, other: String } => "is of `{other}`, {first} of `{robot}`";
            OtherNominal { first: String, parameter: String, value: f64, other: f64 } => "has the nominal {parameter} {other}, {first} has {value}";
            OtherUnit { parameter: String, unit: String, given: String } => "has {parameter} in `{given}`, not in {unit}";
            UnknownParameter { parameter: String } => "has a parameter `{parameter}`, which no robot has";
            NothingInCommon { first: String } => "has nothing that can be compared with {first}";
        }
        E1903 "a result is given twice",
        cause: "Two of the files have the same content: one calibration is no comparison with itself.",
        cure: "Leave one out." {
            Twice { first: String } => "is the same result as {first}";
        }
        E1904 "the dates do not fit the results",
        cause: "There must be one date YYYY-MM-DD for each result, in the order of the results, each after the one before.",
        cure: "Write --dates 2025-03-01,2025-06-01 for two results, oldest first." {
            DateCount { dates: usize, results: usize } => "{dates} dates are given for {results} results";
            NotADate { date: String } => "`{date}` is no date YYYY-MM-DD";
            NotAfter { date: String, before: String } => "{date} is not after {before}";
        }
        E1905 "the robot of a result is not known",
        cause: "The change of the position needs the robot's axes and limits, which robot-identified.toml beside result.json has.",
        cure: "Keep robot-identified.toml beside result.json, or give --robot." {
            NoRobotBeside { looked_for: String } => "there is no {looked_for} beside it";
        }
        I1906 "the results estimate different parameters",
        cause: "A parameter was estimated in one result and not in another one. What was not estimated acts on the others, so that their changes need not be changes of the robot.",
        cure: "Identify all results with the same options from like poses." {
            DifferentlyEstimated { parameters: Names } => "{parameters} are not estimated in all results and are not compared";
        }
    }
}
