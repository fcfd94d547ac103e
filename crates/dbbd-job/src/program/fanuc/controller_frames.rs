//! The frames of a controller, from its file SYSFRAME.VA.

use std::collections::HashMap;

use super::position::pose;
use crate::program::Text;
use dbbd_model::robot::Pose;

/// The variables of the controller with the names that its programs use.
const VARIABLES: [(&str, &str); 2] = [("$MNUFRAME ", "UFRAME"), ("$MNUTOOL ", "UTOOL")];
const NUMBERS: [&str; 6] = ["X:", "Y:", "Z:", "W:", "P:", "R:"];

/// The frames of the first group by their names, such as `UTOOL[2]`. An entry begins with `[1,2] =`, and its six numbers
/// follow in the next lines.
pub(super) fn controller_frames(file: Text<'_>) -> HashMap<String, Pose> {
    let mut frames = HashMap::new();
    let (mut variable, mut name, mut numbers): (Option<&str>, Option<String>, Vec<f64>) =
        (None, None, Vec::new());
    for line in file.text.lines() {
        if let Some((_, head)) = line.split_once("[*SYSTEM*]") {
            variable = VARIABLES.iter().find(|(known, _)| head.starts_with(known)).map(|(_, name)| *name);
            name = None;
        }
        if let Some((index, _)) =
            line.split_once("] =").and_then(|(head, rest)| Some((head.rsplit_once('[')?.1, rest)))
        {
            let number = index
                .split_once(',')
                .filter(|(group, _)| group.trim() == "1")
                .map(|(_, number)| number.trim());
            name = variable.zip(number).map(|(variable, number)| format!("{variable}[{number}]"));
            numbers.clear();
        }
        let Some(named) = &name else { continue };
        let words: Vec<&str> = line.split_whitespace().collect();
        for pair in words.windows(2) {
            if let ([label, number], Some(wanted)) = (pair, NUMBERS.get(numbers.len()))
                && label == wanted
            {
                numbers.extend(number.parse::<f64>());
            }
        }
        if let Ok(six) = <[f64; 6]>::try_from(numbers.as_slice()) {
            frames.insert(named.clone(), pose(six));
            name = None;
        }
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_the_first_group_are_read() {
        let entry = |at: &str, z: f64| {
            format!(
                "     [{at}] =\n  Group: {}   Config: N D B, 0, 0, 0\n  X:     1.000   Y:     -.500   Z:   {z}\n  W:    90.000   P:     0.000   R:     0.000\n",
                &at[..1]
            )
        };
        let text = format!(
            "[*SYSTEM*]$MNUFRAME  Storage: SHADOW  Access: RW  : ARRAY[2,9] OF POSITION\n{}{}[*SYSTEM*]$MNUFRAMENUM  Storage: CMOS  Access: RW  : ARRAY[1] OF BYTE\n     [1] = 3\n[*SYSTEM*]$MNUTOOL  Storage: CMOS  Access: RW  : ARRAY[1,10] OF POSITION\n{}",
            entry("1,3", 7.0),
            entry("2,1", 8.0),
            entry("1,1", 9.0)
        );
        let frames = controller_frames(Text { file: "SYSFRAME.VA", text: &text });
        let mut names: Vec<&String> = frames.keys().collect();
        names.sort();
        assert_eq!(names, ["UFRAME[3]", "UTOOL[1]"]);
        // W turns about X.
        let tool = &frames["UTOOL[1]"];
        assert_eq!((tool.position.y, tool.position.z), (-0.5, 9.0));
        assert!((tool.rotation[(2, 1)] - 1.0).abs() < 1e-12);
    }
}
