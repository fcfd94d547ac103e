//! UR RTDE, version 2: packages of `u16 size` (head included), `u8 type` and content, all big-endian.
//!
//! A client requests the version (`V`), then a recipe (`O`: a rate and names of variables; the answer has the
//! number of the recipe and the types of the variables), then the start (`S`). Data are packages `U` (number of
//! the recipe, values).

use super::{AxesFault, AxesPacket, AxesSample, PacketContent, possible};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::robot::AXES;

pub const PORT: u16 = 30004;
pub const RTDE_VERSION: u16 = 2;
/// The requested variables: seconds of the controller, measured and commanded axes in rad.
pub const VARIABLES: &str = "timestamp,actual_q,target_q";
pub const TYPES: &str = "DOUBLE,VECTOR6D,VECTOR6D";

pub const ASK_VERSION: u8 = b'V';
pub const ASK_CONTROLLER: u8 = b'v';
pub const SET_UP_OUTPUTS: u8 = b'O';
pub const START: u8 = b'S';
pub const PAUSE: u8 = b'P';
pub const DATA: u8 = b'U';

/// Length of size and type.
const HEAD: usize = 3;
const WORD: usize = 8;
/// Content of a data package: number of the recipe, and values.
const DATA_LEN: usize = 1 + WORD * (1 + 2 * AXES);

pub fn package(kind: u8, content: &[u8]) -> Vec<u8> {
    let size = u16::try_from(HEAD + content.len()).unwrap_or(u16::MAX);
    let mut bytes = size.to_be_bytes().to_vec();
    bytes.push(kind);
    bytes.extend(&content[..usize::from(size) - HEAD]);
    bytes
}

pub struct RtdePackage<'a> {
    pub kind: u8,
    pub content: &'a [u8],
    /// Length with the head.
    pub bytes: usize,
}

/// The package at the start of `bytes`; `None` if it is incomplete, an error if its size is impossible.
pub fn next_package(bytes: &[u8]) -> Result<Option<RtdePackage<'_>>, AxesFault> {
    let Some(&[high, low, kind]) = bytes.get(..HEAD) else { return Ok(None) };
    let size = usize::from(u16::from_be_bytes([high, low]));
    if size < HEAD {
        return Err(AxesFault::Framing);
    }
    Ok(bytes.get(HEAD..size).map(|content| RtdePackage { kind, content, bytes: size }))
}

/// The requests of a client; each is sent after the one before was accepted.
pub fn requests(rate_hz: f64) -> [Vec<u8>; 3] {
    let recipe = [&rate_hz.to_be_bytes()[..], VARIABLES.as_bytes()].concat();
    [package(ASK_VERSION, &RTDE_VERSION.to_be_bytes()), package(SET_UP_OUTPUTS, &recipe), package(START, &[])]
}

/// The data package of a sample; unknown commanded axes are replaced by the measured ones.
pub fn data(recipe: u8, sample: &AxesSample) -> Vec<u8> {
    let seconds = sample.ticks.0 as f64 * 1e-6;
    let commanded_deg = sample.commanded_deg.unwrap_or(sample.measured_deg);
    let axes = sample.measured_deg.into_iter().chain(commanded_deg).map(f64::to_radians);
    let values = std::iter::once(seconds).chain(axes).flat_map(f64::to_be_bytes);
    let content: Vec<u8> = std::iter::once(recipe).chain(values).collect();
    package(DATA, &content)
}

/// Extracts packages from a stream.
#[derive(Clone, Debug, Default)]
pub struct RtdeDecoder {
    /// Bytes of a package that is not complete yet.
    pending: Vec<u8>,
    /// Number of the accepted recipe.
    recipe: Option<u8>,
}

impl RtdeDecoder {
    pub(super) fn pending(&self) -> u64 {
        self.pending.len() as u64
    }

    /// Extracts the packages from the next bytes. After an impossible size one byte is skipped.
    pub(super) fn push(&mut self, bytes: &[u8], mut out: impl FnMut(AxesPacket)) {
        self.pending.extend_from_slice(bytes);
        let mut at = 0;
        loop {
            let (content, bytes) = match next_package(&self.pending[at..]) {
                Ok(None) => break,
                Ok(Some(package)) => {
                    (read_package(&mut self.recipe, package.kind, package.content), package.bytes)
                }
                Err(fault) => (PacketContent::Fault(fault), 1),
            };
            out(AxesPacket { content, bytes: bytes as u64 });
            at += bytes;
        }
        self.pending.drain(..at);
    }
}

fn read_package(recipe: &mut Option<u8>, kind: u8, content: &[u8]) -> PacketContent {
    let accepted = content == [1];
    match kind {
        DATA => data_of(*recipe, content).map_or_else(PacketContent::Fault, PacketContent::Sample),
        ASK_VERSION | START => PacketContent::Answer { accepted },
        SET_UP_OUTPUTS => {
            *recipe =
                content.split_first().filter(|(_, types)| *types == TYPES.as_bytes()).map(|(id, _)| *id);
            PacketContent::Answer { accepted: recipe.is_some() }
        }
        _ => PacketContent::Other,
    }
}

fn data_of(recipe: Option<u8>, content: &[u8]) -> Result<AxesSample, AxesFault> {
    let (id, values) = content.split_first().ok_or(AxesFault::OtherRecipe)?;
    if recipe != Some(*id) || content.len() != DATA_LEN {
        return Err(AxesFault::OtherRecipe);
    }
    let (words, _) = values.as_chunks::<WORD>();
    let word = |at: usize| words.get(at).map_or(f64::NAN, |word| f64::from_be_bytes(*word));
    let seconds = word(0);
    let degrees = |from: usize| std::array::from_fn(|axis| word(from + axis).to_degrees());
    let (measured_deg, commanded_deg) = (degrees(1), degrees(1 + AXES));
    // 4e9 s are 4e15 ticks: about half of the ticks that a float represents exactly.
    let clock = (0.0..4e9).contains(&seconds);
    if !clock || !possible(&measured_deg) || !possible(&commanded_deg) {
        return Err(AxesFault::NotANumber);
    }
    let ticks = DeviceTicks((seconds * 1e6).round() as u64);
    Ok(AxesSample { ticks, measured_deg, commanded_deg: Some(commanded_deg), external: None, late: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: AxesSample = AxesSample {
        ticks: DeviceTicks(1_500_000),
        measured_deg: [10.0, -20.0, 30.0, -40.0, 50.0, -60.0],
        commanded_deg: Some([11.0, -21.0, 31.0, -41.0, 51.0, -61.0]),
        external: None,
        late: None,
    };

    fn decoded(decoder: &mut RtdeDecoder, bytes: &[u8]) -> Vec<AxesPacket> {
        let mut packets = Vec::new();
        decoder.push(bytes, |packet| packets.push(packet));
        packets
    }

    /// A decoder whose recipe 7 was accepted.
    fn set_up() -> RtdeDecoder {
        let mut decoder = RtdeDecoder::default();
        let answer = package(SET_UP_OUTPUTS, &[&[7], TYPES.as_bytes()].concat());
        let packets = decoded(&mut decoder, &answer);
        let bytes = answer.len() as u64;
        assert_eq!(packets, [AxesPacket { content: PacketContent::Answer { accepted: true }, bytes }]);
        decoder
    }

    /// The guide of UR: size (2 bytes, with the head), type, content, highest byte first.
    #[test]
    fn package_begins_with_its_size_and_type() {
        assert_eq!(package(ASK_VERSION, &[0, 2]), [0, 5, 86, 0, 2]);
        assert_eq!(package(PAUSE, &[]), [0, 3, 80]);
        assert_eq!(package(DATA, &[0; 300])[..3], [0x01, 0x2f, 85]);
        // A size has 16 bits.
        assert_eq!(package(DATA, &[0; 70_000]).len(), 65_535);
    }

    #[test]
    fn size_decides_where_a_package_ends() {
        let package = next_package(&[0, 5, 86, 1, 2, 9]).unwrap().unwrap();
        assert_eq!((package.kind, package.content, package.bytes), (86, &[1, 2][..], 5));
        let empty = next_package(&[0, 3, 83]).unwrap().unwrap();
        assert_eq!((empty.content.len(), empty.bytes), (0, 3));
        for incomplete in [&[][..], &[0, 5], &[0, 5, 86, 1]] {
            assert!(next_package(incomplete).unwrap().is_none());
        }
        for impossible in [[0, 0, 86], [0, 2, 86]] {
            assert_eq!(next_package(&impossible).err(), Some(AxesFault::Framing));
        }
    }

    /// 125 as IEEE 754 is 405f400000000000; the names have 27 characters.
    #[test]
    fn recipe_is_a_rate_and_the_names() {
        let [version, recipe, start] = requests(125.0);
        assert_eq!(version, [0, 5, 86, 0, 2]);
        assert_eq!(recipe[..11], [0, 38, 79, 0x40, 0x5f, 0x40, 0, 0, 0, 0, 0]);
        assert_eq!(&recipe[11..], b"timestamp,actual_q,target_q");
        assert_eq!(start, [0, 3, 83]);
    }

    /// Head 3, recipe 1, and thirteen numbers of 8 bytes: 108.
    #[test]
    fn sample_returns_from_its_package_however_it_is_split() {
        let bytes = data(7, &SAMPLE);
        assert_eq!((bytes.len(), bytes[0], bytes[1], bytes[3]), (108, 0, 108, 7));
        assert_eq!(bytes[4..12], 1.5f64.to_be_bytes());
        assert_eq!(bytes[12..20], (std::f64::consts::PI / 18.0).to_be_bytes());
        for cut in [1, 5, 108] {
            let mut decoder = set_up();
            let packets: Vec<AxesPacket> =
                bytes.chunks(cut).flat_map(|part| decoded(&mut decoder, part)).collect();
            let [AxesPacket { content: PacketContent::Sample(sample), bytes: 108 }] = &packets[..] else {
                panic!("{packets:?}");
            };
            assert_eq!((sample.ticks, sample.late), (SAMPLE.ticks, None));
            let near = |a: &[f64; AXES], b: &[f64; AXES]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(near(&sample.measured_deg, &SAMPLE.measured_deg));
            assert!(near(&sample.commanded_deg.unwrap(), &SAMPLE.commanded_deg.unwrap()));
            assert_eq!(decoder.pending(), 0);
        }
    }

    #[test]
    fn unknown_commanded_axes_are_sent_as_measured() {
        let sample = AxesSample { commanded_deg: None, ..SAMPLE };
        let bytes = data(7, &sample);
        assert_eq!(bytes[12..60], bytes[60..108]);
    }

    #[test]
    fn data_of_another_recipe_or_length_are_a_fault() {
        let fault = |decoder: &mut RtdeDecoder, bytes: &[u8]| match decoded(decoder, bytes)[..] {
            [AxesPacket { content: PacketContent::Fault(fault), .. }] => Some(fault),
            _ => None,
        };
        let bytes = data(7, &SAMPLE);
        assert_eq!(fault(&mut RtdeDecoder::default(), &bytes), Some(AxesFault::OtherRecipe));
        assert_eq!(fault(&mut set_up(), &data(8, &SAMPLE)), Some(AxesFault::OtherRecipe));
        assert_eq!(fault(&mut set_up(), &package(DATA, &bytes[3..107])), Some(AxesFault::OtherRecipe));
        assert_eq!(fault(&mut set_up(), &package(DATA, &[])), Some(AxesFault::OtherRecipe));
        for (at, value) in [(4, f64::NAN), (4, -0.001), (4, 4e9), (12, f64::INFINITY), (60, 63.0)] {
            let mut bytes = bytes.clone();
            bytes[at..at + 8].copy_from_slice(&value.to_be_bytes());
            assert_eq!(fault(&mut set_up(), &bytes), Some(AxesFault::NotANumber), "{at} {value}");
        }
    }

    #[test]
    fn answers_tell_what_was_accepted() {
        let mut decoder = RtdeDecoder::default();
        for (kind, content, expected) in [
            (ASK_VERSION, vec![1], PacketContent::Answer { accepted: true }),
            (ASK_VERSION, vec![0], PacketContent::Answer { accepted: false }),
            (START, vec![1], PacketContent::Answer { accepted: true }),
            (
                SET_UP_OUTPUTS,
                b"\x07DOUBLE,NOT_FOUND,VECTOR6D".to_vec(),
                PacketContent::Answer { accepted: false },
            ),
            (ASK_CONTROLLER, vec![1], PacketContent::Other),
        ] {
            assert_eq!(decoded(&mut decoder, &package(kind, &content))[0].content, expected);
        }
    }

    #[test]
    fn one_byte_is_skipped_after_an_impossible_size() {
        let mut decoder = set_up();
        let packets = decoded(&mut decoder, &[&[0, 1][..], &data(7, &SAMPLE)].concat());
        let bytes: Vec<u64> = packets.iter().map(|packet| packet.bytes).collect();
        // 0 1 | 1 0: the size 256 waits for more.
        assert_eq!(bytes, [1]);
        assert_eq!(decoder.pending(), 109);
    }
}
