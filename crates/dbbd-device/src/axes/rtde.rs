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
    /// Starts like a package.
    pending: Vec<u8>,
    /// Number of the accepted recipe.
    recipe: Option<u8>,
}

impl RtdeDecoder {
    pub(super) fn pending(&self) -> u64 {
        self.pending.len() as u64
    }

    /// After an impossible size one byte is skipped.
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
    // Half of the ticks that a float represents exactly.
    let clock = (0.0..4e9).contains(&seconds);
    if !clock || !possible(&measured_deg) || !possible(&commanded_deg) {
        return Err(AxesFault::NotANumber);
    }
    let ticks = DeviceTicks((seconds * 1e6).round() as u64);
    Ok(AxesSample { ticks, measured_deg, commanded_deg: Some(commanded_deg), late: None })
}
