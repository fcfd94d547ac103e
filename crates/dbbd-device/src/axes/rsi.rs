//! KUKA RSI: the datagram of each cycle, and the answer without a correction.
//!
//! `<Rob Type="KUKA"><AIPos A1=".." .. A6=".."/><ASPos ../><Delay D="0"/><IPOC>123</IPOC></Rob>`, one UDP datagram per cycle,
//! with the elements of the Ethernet configuration in any order. `AIPos` are the measured axes, `ASPos` the
//! commanded ones, degrees; `IPOC` is the time stamp in ms, which an answer repeats.

use roxmltree::{Document, Node};

use super::{AxesFault, AxesSample, possible};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::robot::AXES;

/// Longest datagram: 64 channels need less.
pub const MAX_DATAGRAM_BYTES: usize = 16 << 10;
pub const AXIS_NAMES: [&str; AXES] = ["A1", "A2", "A3", "A4", "A5", "A6"];

pub fn read_datagram(bytes: &[u8]) -> Result<AxesSample, AxesFault> {
    if bytes.len() > MAX_DATAGRAM_BYTES {
        return Err(AxesFault::TooLong);
    }
    let text = std::str::from_utf8(bytes.trim_ascii()).map_err(|_| AxesFault::NotXml)?;
    let document = Document::parse(text.trim_end_matches('\0')).map_err(|_| AxesFault::NotXml)?;
    let root = document.root_element();
    if !root.has_tag_name("Rob") {
        return Err(AxesFault::NotXml);
    }
    let child = |name: &str| root.children().find(|node| node.has_tag_name(name));
    let ticks = child("IPOC").and_then(|node| node.text()).ok_or(AxesFault::Incomplete)?;
    let ticks = DeviceTicks(ticks.trim().parse().map_err(|_| AxesFault::NotANumber)?);
    let measured_deg = angles(child("AIPos").ok_or(AxesFault::Incomplete)?)?;
    let commanded_deg = child("ASPos").map(angles).transpose()?;
    let late = child("Delay").and_then(|node| node.attribute("D")?.trim().parse().ok());
    Ok(AxesSample { ticks, measured_deg, commanded_deg, late })
}

fn angles(node: Node<'_, '_>) -> Result<[f64; AXES], AxesFault> {
    let mut angles_deg = [0.0; AXES];
    for (angle, name) in angles_deg.iter_mut().zip(AXIS_NAMES) {
        let text = node.attribute(name).ok_or(AxesFault::Incomplete)?;
        *angle = text.trim().parse().map_err(|_| AxesFault::NotANumber)?;
    }
    if possible(&angles_deg) { Ok(angles_deg) } else { Err(AxesFault::NotANumber) }
}

/// A datagram as a controller writes it, with its digits.
pub fn write_datagram(sample: &AxesSample) -> String {
    let element = |name: &str, axes: &[f64; AXES]| {
        let values: String =
            AXIS_NAMES.iter().zip(axes).map(|(axis, deg)| format!(" {axis}=\"{deg:.4}\"")).collect();
        format!("<{name}{values}/>")
    };
    let measured = element("AIPos", &sample.measured_deg);
    let commanded = sample.commanded_deg.map_or(String::new(), |axes| element("ASPos", &axes));
    let late = sample.late.unwrap_or(0);
    let ipoc = sample.ticks.0;
    format!("<Rob Type=\"KUKA\">{measured}{commanded}<Delay D=\"{late}\"/><IPOC>{ipoc}</IPOC></Rob>")
}

/// The answer without a correction: `SENTYPE` of the Ethernet configuration is `ImFree`.
pub fn zero_answer(ticks: DeviceTicks) -> String {
    let zeros: String = AXIS_NAMES.iter().map(|axis| format!(" {axis}=\"0.0000\"")).collect();
    format!("<Sen Type=\"ImFree\"><AK{zeros}/><IPOC>{}</IPOC></Sen>", ticks.0)
}
