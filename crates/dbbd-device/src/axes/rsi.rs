//! KUKA RSI: the datagram of each cycle, and the answer without a correction.
//!
//! `<Rob Type="KUKA"><AIPos A1=".." .. A6=".."/><ASPos ../><Delay D="0"/><IPOC>123</IPOC></Rob>`, one UDP datagram per cycle,
//! with the elements of the Ethernet configuration in any order. `AIPos` are the measured axes, `ASPos` the
//! commanded ones, degrees; `EIPos` are the measured external axes, `E1` to `E6`; `IPOC` is the time stamp in ms, which an
//! answer repeats.

use roxmltree::{Document, Node};

use super::{AxesFault, AxesSample, EXTERNAL_AXES, possible};
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
    let external = child("EIPos").map(external).transpose()?;
    let late = child("Delay").and_then(|node| node.attribute("D")?.trim().parse().ok());
    Ok(AxesSample { ticks, measured_deg, commanded_deg, external, late })
}

fn angles(node: Node<'_, '_>) -> Result<[f64; AXES], AxesFault> {
    let mut angles_deg = [0.0; AXES];
    for (angle, name) in angles_deg.iter_mut().zip(AXIS_NAMES) {
        let text = node.attribute(name).ok_or(AxesFault::Incomplete)?;
        *angle = text.trim().parse().map_err(|_| AxesFault::NotANumber)?;
    }
    if possible(&angles_deg) { Ok(angles_deg) } else { Err(AxesFault::NotANumber) }
}

fn external(node: Node<'_, '_>) -> Result<[f64; EXTERNAL_AXES], AxesFault> {
    let mut positions = [0.0_f64; EXTERNAL_AXES];
    for (position, number) in positions.iter_mut().zip(1..) {
        if let Some(text) = node.attribute(format!("E{number}").as_str()) {
            *position = text.trim().parse().map_err(|_| AxesFault::NotANumber)?;
        }
    }
    if positions.into_iter().all(f64::is_finite) { Ok(positions) } else { Err(AxesFault::NotANumber) }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axes::MAX_AXIS_DEG;

    const SAMPLE: AxesSample = AxesSample {
        ticks: DeviceTicks(4_208_163),
        measured_deg: [1.5, -90.0, 90.0, 0.25, -45.125, 180.0],
        commanded_deg: Some([1.25, -90.5, 90.5, 0.5, -45.0, 179.5]),
        external: None,
        late: Some(3),
    };

    #[test]
    fn datagram_returns_the_sample() {
        let text = write_datagram(&SAMPLE);
        assert!(text.starts_with("<Rob Type=\"KUKA\"><AIPos A1=\"1.5000\" A2=\"-90.0000\""), "{text}");
        assert!(text.ends_with("<Delay D=\"3\"/><IPOC>4208163</IPOC></Rob>"), "{text}");
        assert_eq!(read_datagram(text.as_bytes()), Ok(SAMPLE));
        // A controller ends a datagram with zeros or blanks.
        assert_eq!(read_datagram(format!("{text}\0\0").as_bytes()), Ok(SAMPLE));
        assert_eq!(read_datagram(format!(" {text}\r\n").as_bytes()), Ok(SAMPLE));
    }

    #[test]
    fn commanded_axes_and_delay_may_be_missing() {
        let text = "<Rob><IPOC> 12 </IPOC><AIPos A6='6' A5='5' A4='4' A3='3' A2='2' A1='1'/></Rob>";
        let measured_deg = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let sample = AxesSample {
            ticks: DeviceTicks(12),
            measured_deg,
            commanded_deg: None,
            external: None,
            late: None,
        };
        assert_eq!(read_datagram(text.as_bytes()), Ok(sample));
        // `DEF_EIPos` of the Ethernet configuration sends as many external axes as the controller has.
        let with_rail = text.replace("<IPOC>", "<EIPos E1=\"499.5\" E2=\"-1.0E1\"/><IPOC>");
        let external = Some([499.5, -10.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(read_datagram(with_rail.as_bytes()), Ok(AxesSample { external, ..sample }));
        assert_eq!(read_datagram(with_rail.replace("499.5", "inf").as_bytes()), Err(AxesFault::NotANumber));
    }

    #[test]
    fn invalid_datagrams_are_faults() {
        let text = write_datagram(&SAMPLE);
        let fault = |from: &str, to: &str| read_datagram(text.replace(from, to).as_bytes()).unwrap_err();
        assert_eq!(fault("Rob", "Sen"), AxesFault::NotXml);
        assert_eq!(fault("</Rob>", ""), AxesFault::NotXml);
        assert_eq!(read_datagram(b"\xff\xfe"), Err(AxesFault::NotXml));
        assert_eq!(fault("IPOC", "ICOP"), AxesFault::Incomplete);
        assert_eq!(fault("AIPos", "ACPos"), AxesFault::Incomplete);
        assert_eq!(fault("A6=", "A7="), AxesFault::Incomplete);
        assert_eq!(fault("4208163", "-1"), AxesFault::NotANumber);
        assert_eq!(fault("1.5000", "one"), AxesFault::NotANumber);
        assert_eq!(fault("1.5000", "NaN"), AxesFault::NotANumber);
        assert_eq!(fault("179.5000", "3600.001"), AxesFault::NotANumber);
    }

    #[test]
    fn limits_belong_to_what_is_allowed() {
        let measured_deg = [MAX_AXIS_DEG, -MAX_AXIS_DEG, 0.0, 0.0, 0.0, 0.0];
        let sample = AxesSample { measured_deg, ..SAMPLE };
        assert_eq!(read_datagram(write_datagram(&sample).as_bytes()), Ok(sample));
        let padded = |bytes: usize| {
            let text = write_datagram(&SAMPLE);
            format!("{text}{}", " ".repeat(bytes - text.len()))
        };
        assert_eq!(read_datagram(padded(16_384).as_bytes()), Ok(SAMPLE));
        assert_eq!(read_datagram(padded(16_385).as_bytes()), Err(AxesFault::TooLong));
    }

    #[test]
    fn answer_repeats_the_time_stamp_and_corrects_nothing() {
        let zeros = "A1=\"0.0000\" A2=\"0.0000\" A3=\"0.0000\" A4=\"0.0000\" A5=\"0.0000\" A6=\"0.0000\"";
        let expected = format!("<Sen Type=\"ImFree\"><AK {zeros}/><IPOC>77</IPOC></Sen>");
        assert_eq!(zero_answer(DeviceTicks(77)), expected);
    }
}
