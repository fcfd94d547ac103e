//! Every entrance at which bytes of others come in, and what must hold whatever they are: nothing panics,
//! and what is accepted keeps its laws. The suite sends the corpus and mutations of it through these
//! (`tests/suite/any_bytes_are_taken.rs`), the targets beside this file whatever a fuzzer finds.

use std::path::Path;
use std::sync::OnceLock;

use dbbd::daemon::ServiceConfig;
use dbbd::live::{JobRequest, StartRequest};
use dbbd_device::axes::{AxesDecoder, AxesProtocol, rsi, rtde};
use dbbd_device::protocol::{DecodedItem, ProtocolDefinition};
use dbbd_job::plan::{Job, Plan};
use dbbd_job::program::Correction;
use dbbd_job::program::fanuc::GivenFrames;
use dbbd_job::program::krl::{self, Files, Given};
use dbbd_job::program::{self, Language, Moved, Program, Text, fanuc, rapid, urscript};
use dbbd_job::recording::TelegramReader;
use dbbd_job::recording::axes::AxesReceiver;
use dbbd_job::recording::capture;
use dbbd_job::recording::import::{TraceBar, TraceFormat, TraceMapping, TraceReader};
use dbbd_job::report::export::urdf_patch;
use dbbd_job::request::Request;
use dbbd_job::robot_description::{self, FactoryTable, KnownOfRobot};
use dbbd_job::sim::world::WorldSetup;
use dbbd_job::sim::{SimulatedController, truth};
use dbbd_model::base::table::TableReader;
use dbbd_model::base::units::HostNs;
use dbbd_model::circular::{self, CircularSettings};
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::measurement::{BaseBall, Measurements};
use dbbd_model::provenance::{Artefact, ArtefactRole, Identity, Provenance};
use dbbd_model::robot::Robot;

/// An entrance.
pub(crate) type Entry = fn(&[u8]);

/// The entrances by name; each has a corpus of that name.
pub(crate) const ENTRIES: [(&str, Entry); 18] = [
    ("axes", axes),
    ("capture", capture_reader),
    ("circle", circle),
    ("decoder", decoder),
    ("definition", definition),
    ("description", description),
    ("fanuc", |data| script("m10id12", data)),
    ("http", http),
    ("job", job),
    ("krl", krl_reader),
    ("plan", plan),
    ("rapid", |data| script("irb1600-10-145", data)),
    ("result", result),
    ("robot", robot),
    ("settings", settings),
    ("tables", tables),
    ("trace", trace),
    ("urscript", |data| script("ur10e", data)),
];

/// A framing that no built-in definition has: a length in the frame.
const LENGTH: &str = include_str!("length.toml");

/// The same with silence as the end.
pub(crate) fn ended_by_silence() -> String {
    let length = "kind = \"length\"\nsync = \"aa 55\"\nlen_at = 2\nlen_adds = 3\n";
    LENGTH.replace(length, "kind = \"gap\"\nidle_us = 2000\n")
}

fn definitions() -> &'static [ProtocolDefinition] {
    static ALL: OnceLock<Vec<ProtocolDefinition>> = OnceLock::new();
    ALL.get_or_init(|| {
        let silent = ended_by_silence();
        let built_in = ProtocolDefinition::built_in().iter().map(|(_, text)| *text);
        let all = built_in.chain([LENGTH, silent.as_str()]);
        all.map(|text| ProtocolDefinition::from_toml("definition", text).expect("a definition that is good"))
            .collect()
    })
}

/// The first byte chooses the definition, the second how the rest is cut.
fn decoder(data: &[u8]) {
    let [which, piece, stream @ ..] = data else { return };
    let Some(definition) = definitions().get(usize::from(*which) % definitions().len()) else { return };
    let (mut whole, mut pieces) = (Vec::new(), Vec::new());
    let (mut decoder, mut again) = (definition.decoder(), definition.decoder());
    decoder.push(stream, &mut whole);
    stream.chunks(usize::from(*piece).max(1)).for_each(|piece| again.push(piece, &mut pieces));
    let same = |(one, other): (&DecodedItem, &DecodedItem)| match (one, other) {
        // A reading may be one that equals nothing.
        (DecodedItem::Sample(a, n), DecodedItem::Sample(b, m)) => {
            (a.offset, a.reading_mm.to_bits(), a.sequence, n)
                == (b.offset, b.reading_mm.to_bits(), b.sequence, m)
        }
        _ => one == other,
    };
    assert!(
        whole.len() == pieces.len() && whole.iter().zip(&pieces).all(same),
        "{}: the cuts matter",
        definition.id
    );
    decoder.interrupt(&mut whole);
    let accounted: u64 = whole.iter().map(DecodedItem::bytes).sum();
    assert_eq!((accounted, decoder.pending()), (stream.len() as u64, 0), "{}", definition.id);
    for one in &whole {
        if let DecodedItem::Sample(sample, _) = one {
            // What a device has said can be said, or is refused.
            let _ = definition.encoder().encode(sample, &mut Vec::new());
            let _ = definition.flags(sample.status);
        }
    }
}

/// Packets of a controller's axes: a datagram of RSI, and a stream of RTDE behind an agreed recipe; the first byte says how
/// the stream is cut.
fn axes(data: &[u8]) {
    let Some((piece, packets)) = data.split_first() else { return };
    for protocol in [AxesProtocol::Rsi, AxesProtocol::Rtde] {
        let recipe = rtde::package(rtde::SET_UP_OUTPUTS, &[b"\x01", rtde::TYPES.as_bytes()].concat());
        let stream =
            if protocol == AxesProtocol::Rtde { [&recipe, packets].concat() } else { packets.to_vec() };
        let (mut whole, mut pieces) = (Vec::new(), Vec::new());
        let (mut decoder, mut again) = (AxesDecoder::new(protocol), AxesDecoder::new(protocol));
        decoder.push(&stream, |packet| whole.push(packet));
        let accounted: u64 = whole.iter().map(|packet| packet.bytes).sum();
        assert_eq!(accounted + decoder.pending(), stream.len() as u64, "{protocol:?}");
        if protocol == AxesProtocol::Rtde {
            stream
                .chunks(usize::from(*piece).max(1))
                .for_each(|part| again.push(part, |one| pieces.push(one)));
            assert_eq!(whole, pieces, "the cuts matter");
        }
        let mut receiver = AxesReceiver::new(protocol);
        receiver.push(HostNs(1), &stream, |_, _, sample| {
            assert!(sample.measured_deg.iter().all(|deg| deg.is_finite()));
            // What was understood is understood again.
            if protocol == AxesProtocol::Rsi {
                let read = rsi::read_datagram(rsi::write_datagram(&sample).as_bytes());
                assert_eq!(read.map(|read| read.ticks), Ok(sample.ticks));
            }
        });
        let counts = receiver.counts();
        let parts =
            [counts.used, counts.late, counts.doubled, counts.stray, counts.control, counts.malformed];
        assert_eq!((counts.packets, counts.bytes), (parts.iter().sum(), stream.len() as u64));
    }
}

fn definition(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match ProtocolDefinition::from_toml("definition.toml", text) {
        Ok(definition) => {
            let (mut decoder, mut out) = (definition.decoder(), Vec::new());
            let bytes: Vec<u8> = (0..=255).chain(data.iter().copied()).collect();
            decoder.push(&bytes, &mut out);
            decoder.interrupt(&mut out);
            assert_eq!(out.iter().map(DecodedItem::bytes).sum::<u64>(), bytes.len() as u64);
            let _ = (definition.layout(), definition.framing(), definition.resolution_mm());
        }
        Err(wrong) => assert!(!wrong.to_string().is_empty()),
    }
}

/// The largest correction of a program, mm.
const LIMIT_MM: f64 = 8.0;

fn built_in(name: &str) -> Robot {
    Robot::by_name(name).expect("a robot of that name").expect("its file can be read")
}

/// A robot with errors, as it was identified.
fn identified(name: &str) -> Robot {
    let nominal = built_in(name);
    Robot { nominal: Some(Box::new(nominal.clone())), ..truth::draw_true_robot(&nominal, 1, 1.0) }
}

fn file<'a>(file: &'a str, text: &'a str) -> Text<'a> {
    Text { file, text }
}

/// A `.src`, behind a zero byte a `.dat`, behind another a `$config.dat`.
fn krl_reader(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let (source, rest) = text.split_once('\0').unwrap_or((text, ""));
    let (data, config) = rest.split_once('\0').unwrap_or((rest, ""));
    let parsed = krl::parse_data("M.dat", data).ok();
    if let Some(data) = &parsed {
        let _ = (krl::logged_axes(data), krl::plan_hash(data));
        let _ = (krl::absolute_accuracy(data), krl::read_setup(data));
    }
    let texts = [("M.src", source), ("M.dat", data)];
    let wanted = |wanted: &str| texts.iter().find(|(name, text)| *name == wanted && !text.is_empty());
    let open = |name: &str| Ok(wanted(name).map(|(name, text)| ((*name).to_owned(), (*text).to_owned())));
    if let Ok(program) = krl::Program::open("M", open) {
        execute(program.into(), &built_in("kr60ha"));
    }
    let files = Files {
        source: file("M.src", source),
        data: (!data.is_empty()).then(|| file("M.dat", data)),
        config: (!config.is_empty()).then(|| file("config.dat", config)),
    };
    let Ok(points) = krl::read(files, Given::default()) else { return };
    let Ok(corrected) = krl::compensate(files, &points, Correction::of(&identified("kr60ha"), LIMIT_MM))
    else {
        return;
    };
    let data = corrected.data.as_deref().map(|data| file("M.dat", data));
    let again =
        krl::read(Files { source: file("M.src", &corrected.source), data, ..files }, Given::default());
    let again = again.expect("a program that was corrected is read again");
    check_corrected(&corrected.moved, [points.points.len(), again.points.len()]);
    check_stamped(Language::Krl, &corrected.source);
}

/// A program of a robot's language, and behind a zero byte the frames of its controller: a module, or SYSFRAME.VA.
fn script(robot: &str, data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let (source, config) = text.split_once('\0').unwrap_or((text, ""));
    let (nominal, first) = (built_in(robot), ("M".to_owned(), source.to_owned()));
    let language = Language::of_robot(&nominal);
    let opened = match language {
        Language::Rapid => rapid::open(first, Vec::new()),
        Language::Urscript => urscript::open(first),
        Language::Krl | Language::Fanuc => fanuc::open(first, Vec::new()),
    };
    if let Ok(listing) = opened {
        execute(listing.into(), &nominal);
    }
    let config = (!config.is_empty()).then(|| file("config", config));
    let read = |source| match language {
        Language::Rapid => rapid::read(file("M", source), config),
        Language::Urscript => urscript::read(file("M", source), None),
        Language::Krl | Language::Fanuc => {
            fanuc::read(file("M", source), GivenFrames { config, ..GivenFrames::default() })
        }
    };
    let Ok(points) = read(source) else { return };
    let corrected = points.compensate(file("M", source), Correction::of(&identified(robot), LIMIT_MM));
    let Ok((corrected, moved)) = corrected else { return };
    let again = read(&corrected).expect("a program that was corrected is read again");
    check_corrected(&moved, [points.points.len(), again.points.len()]);
    check_stamped(language, &corrected);
}

/// Every point is corrected, none by more than the limit, and the corrected program has the same.
fn check_corrected(moved: &[Moved], points: [usize; 2]) {
    assert!(moved.iter().all(|moved| moved.shift_mm <= LIMIT_MM));
    assert_eq!(points, [moved.len(); 2], "a correction changes the points");
}

/// What a program says of its origin is read as it was written, and written once.
fn check_stamped(language: Language, text: &str) {
    let mut chain = Provenance { dbbd: "1".into(), ..Provenance::default() };
    chain.add(&Artefact::new(ArtefactRole::Robot, "a robot; of cell 7.toml", "text"));
    let once = program::stamped(language, text, &chain).expect("a chain that can be written");
    assert_eq!(program::stamped(language, &once, &chain).ok().as_ref(), Some(&once), "written twice");
    let read = program::provenance("M", &once).expect("a chain that was written");
    assert!(read == chain || read.is_empty(), "{read:?}");
}

/// What is read is executed for a while.
fn execute(program: Program, robot: &Robot) {
    let Ok(mut controller) = SimulatedController::new(program, robot, 100.0) else { return };
    for _ in 0..4 {
        match controller.step(0.5) {
            Ok(moment) if moment.done => return,
            Ok(_) => controller.go_on(),
            Err(_) => return,
        }
    }
}

fn capture_reader(data: &[u8]) {
    let look = |bytes: &[u8]| {
        let whole = capture::read_capture(bytes);
        let damaged: u64 = whole.damages.iter().map(|damage| damage.bytes).sum();
        assert!(damaged <= bytes.len() as u64);
        let _ = (whole.ended(), whole.attachment("plan.csv"), whole.samples().count());
        whole
    };
    look(data);
    if let Some((kind, payload)) = data.split_first() {
        let whole = look(&sealed(kind % 8, payload));
        assert!(!whole.records.is_empty() || !whole.damages.is_empty(), "a record goes in silence");
    }
}

/// A capture of one record whose checksum holds, so that what stands behind it is tried as well.
fn sealed(kind: u8, payload: &[u8]) -> Vec<u8> {
    const CRC_32C: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);
    let mut head = b"DBBDCAP\n".to_vec();
    head.extend(2_u32.to_le_bytes());
    head.extend(CRC_32C.checksum(&head).to_le_bytes());
    let mut record = vec![kind];
    record.extend((payload.len() as u32).to_le_bytes());
    record.extend(7_u64.to_le_bytes());
    record.extend(payload);
    let check = CRC_32C.checksum(&record).to_le_bytes();
    [&head[..], &[0xDB, 0xBD, 0x5A, 0xA5], &record, &check].concat()
}

/// A `plan.csv` and a `plan.json` behind a zero byte; the hash that ties them is made to fit.
fn plan(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let (csv, json) = text.split_once('\0').unwrap_or((text, "{}"));
    let hash = crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(csv.as_bytes());
    let json = match serde_json::from_str::<serde_json::Value>(json) {
        Ok(serde_json::Value::Object(mut header)) => {
            header.insert("hash".into(), format!("{hash:016x}").into());
            serde_json::Value::Object(header).to_string()
        }
        _ => json.to_owned(),
    };
    if let Ok(plan) = Plan::from_files("plan.csv", csv, "plan.json", &json) {
        let (csv, json) = plan.to_files().unwrap();
        let again = Plan::from_files("plan.csv", &csv, "plan.json", &json);
        assert!(again.is_ok_and(|again| again.rows == plan.rows), "a plan that was read is not read again");
    }
}

fn job(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Err(wrong) = Job::from_toml("job.toml", text) {
        assert!(!wrong.to_string().is_empty());
    }
}

fn robot(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(robot) = Robot::from_toml("robot.toml", text) {
        check_robot(&robot);
    }
}

/// Angles go through radians, which may cost their last bit.
fn check_robot(robot: &Robot) {
    let again = Robot::from_toml("robot.toml", &robot.to_toml().unwrap());
    assert!(again.is_ok(), "what was read and written is not read again");
    let _ = robot.geometry.ball(&[0.1; 6]);
}

/// A robot that is no robot is refused when it is written.
fn check_imported(robot: &Robot) {
    if let Ok(robot) = Robot::from_toml("robot.toml", &robot.to_toml().unwrap()) {
        check_robot(&robot);
    }
}

/// A robot as others describe it: a URDF, `$machine.dat`, a factory calibration, the messages of a controller.
fn description(data: &[u8]) {
    if let Ok(table) = FactoryTable::receive(&mut &data[..])
        && let Ok(imported) = table.imported(&built_in("ur10e"))
    {
        check_imported(&imported.robot);
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    let like = built_in("ur10e");
    let known = KnownOfRobot { like: Some(&like), ..KnownOfRobot::default() };
    if let Ok(imported) = robot_description::import("arm", text, known) {
        check_imported(&imported.robot);
    }
    let robot = identified("kr60ha");
    let read = |text: &str| robot_description::import("arm", text, KnownOfRobot::default());
    if let Ok(patched) = urdf_patch::patch("arm", text, &robot, &[]) {
        assert!(read(text).is_err() || read(&patched.text).is_ok(), "not read again after the patch");
    }
}

/// A `result.json`; its checksum is tried as it is, and left out.
fn result(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let _ = CalibrationResult::from_json("result.json", text);
    let Ok(json) = serde_json::from_str(text) else { return };
    if let Ok(result) = CalibrationResult::from_value(json) {
        let written = serde_json::to_value(&result).expect("a result that can be written");
        assert_eq!(CalibrationResult::from_value(written), Ok(result), "not read as it was written");
    }
}

/// TOML beside job and robot: an identity, a world, the configuration of the service.
fn settings(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(identity) = Identity::from_toml("identity.toml", text) {
        let written = serde_json::to_value(&identity).expect("an identity that can be written");
        let again = serde_json::from_value::<Identity>(written);
        assert!(again.is_ok_and(|again| again == identity), "not read as it was written");
        let _ = (identity.facts(), identity.check_dates(0), identity.old_certificate("2026-01-01"));
    }
    if let Ok(world) = WorldSetup::new(&[], Some(("world.toml", text))) {
        assert!(world.check().is_ok());
    }
    if let Ok(config) = ServiceConfig::from_toml(Path::new("dbbd.toml"), text) {
        let endpoint = config.endpoint;
        let is_guarded = endpoint.token.is_some() || !endpoint.users.is_empty();
        assert!(is_guarded || endpoint.address.ip().is_loopback(), "{endpoint:?} is open");
    }
}

/// Measurements, positions, ball centres, poses; and telegrams, which come in a stream.
fn tables(data: &[u8]) {
    let (mut reader, mut slow) = (TelegramReader::default(), TelegramReader::default());
    let whole = reader.push(data);
    let pieces: Vec<_> = data.chunks(3).flat_map(|piece| slow.push(piece)).collect();
    assert_eq!(whole, pieces);
    let table = || TableReader::of("table.csv", data);
    if let Ok(observations) = table().and_then(|mut table| Measurements::from_table(&mut table)) {
        let again = Measurements::from_csv("observations.csv", &observations.to_csv());
        assert!(again.is_ok_and(|again| again == observations), "not read as they were written");
    }
    if let Ok(centres) = table().and_then(|mut table| BaseBall::from_table(&mut table)) {
        let again = BaseBall::from_csv("centres.csv", &BaseBall::to_csv(&centres));
        assert!(again.is_ok_and(|again| again == centres), "not read as they were written");
    }
    if let Ok(positions) = table().and_then(|mut table| Measurements::positions_from_table(&mut table)) {
        let text = positions.positions_csv(|_| true).unwrap_or_default();
        let again = TableReader::of("positions.csv", &text)
            .and_then(|mut table| Measurements::positions_from_table(&mut table));
        assert!(again.is_ok_and(|again| again == positions), "not read as they were written");
    }
    let _ = table().and_then(|mut table| Measurements::poses_from_table(&mut table));
}

/// A mapping, and behind a zero byte a trace of other software.
fn trace(data: &[u8]) {
    let at = data.iter().position(|byte| *byte == 0).unwrap_or(0);
    let (mapping, trace) = data.split_at(at);
    let mapping = std::str::from_utf8(mapping).ok();
    let mapping = mapping.and_then(|text| TraceMapping::from_toml("mapping.toml", text).ok());
    let (Some(mapping), Some(trace)) = (mapping, trace.get(1..)) else { return };
    let table = || TableReader::new("trace.csv", trace, mapping.layout());
    let bar = TraceBar { length_mm: 300.0, stroke_mm: [-5.0, 5.0] };
    let format = table().and_then(|mut table| TraceFormat::detect(&mut table, &mapping, bar.length_mm));
    let (Ok(table), Ok(format)) = (table(), format) else { return };
    let mut reader = TraceReader::new(table, &mapping, &format, bar);
    let (mut last, mut samples) = (HostNs(0), 0);
    while let Ok(row) = reader.row() {
        let Some((host, sample)) = row.sample else {
            let finished = reader.finish();
            assert!(samples > 0 || finished.is_err());
            if let Ok((counts, _)) = finished {
                assert_eq!(counts.samples, samples);
                let _ = counts.findings(last.seconds_since(HostNs(0)), 0.5).count();
            }
            return;
        };
        assert!(host >= last && sample.reading_mm.is_finite(), "{host:?} {sample:?}");
        (last, samples) = (host, samples + 1);
    }
}

/// A circular test of other software.
fn circle(data: &[u8]) {
    let table = TableReader::of("circle.csv", data);
    let Ok(traces) = table.and_then(|mut table| circular::traces_from_table(&mut table)) else { return };
    let lengths: Vec<f64> =
        traces.iter().flat_map(|trace| &trace.points).map(|point| point.length_mm).collect();
    let radius_mm = lengths.iter().sum::<f64>() / lengths.len() as f64;
    let settings = CircularSettings { draws: 20, ..CircularSettings::new(radius_mm) };
    if let Ok(found) = circular::circular(&traces, &settings) {
        let numbers =
            circular::QUANTITY_NAMES.map(|name| found.get(name)).map(|found| [found.value, found.u95]);
        assert!(numbers.iter().flatten().flatten().all(|value| value.is_finite()), "{numbers:?}");
    }
}

/// Bodies of requests to the service, and requests to a child process.
fn http(data: &[u8]) {
    let _ = serde_json::from_slice::<StartRequest>(data);
    let _ = serde_json::from_slice::<JobRequest>(data);
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(request) = Request::from_json("request", text) {
        let written = serde_json::to_string(&request).expect("a request that can be written");
        assert_eq!(Request::from_json("request", &written).ok(), Some(request), "not read as it was written");
    }
}

/// Sends bytes through an entrance.
pub(crate) fn run(name: &str, data: &[u8]) {
    let entry = ENTRIES.iter().find(|(known, _)| *known == name);
    let (_, entry) = entry.expect("an entrance of that name");
    entry(data);
}
