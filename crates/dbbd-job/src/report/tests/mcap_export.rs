//! The MCAP export is the file that the format's own library writes of the same records, byte for byte.

use std::io::Cursor;

use dbbd_job::recording::capture::{CaptureRecord, RunEvent, StampedRecord};
use dbbd_job::report::export::mcap::{CHANNELS, McapFile};
use dbbd_model::base::units::HostNs;
use dbbd_model::measurement::sample::Sample;
use mcap::read::ChunkFlattener;
use mcap::records::Record as Read;
use mcap::{Attachment, WriteOptions, Writer};

fn exported(records: impl IntoIterator<Item = CaptureRecord>) -> Vec<u8> {
    let mut file = Vec::new();
    let mut export = McapFile::new(&mut file, None).unwrap();
    for (at, record) in records.into_iter().enumerate() {
        export.add(&StampedRecord { host: HostNs(1_000_000 * at as u64), record }).unwrap();
    }
    assert_eq!(export.finish().unwrap().len(), CHANNELS.len());
    file
}

/// What the library writes of the records that it reads.
fn written_again(file: &[u8]) -> Vec<u8> {
    let library = concat!("dbbd ", env!("CARGO_PKG_VERSION"));
    let options = WriteOptions::new().compression(None).library(library);
    let mut again = Writer::with_options(Cursor::new(Vec::new()), options).unwrap();
    for record in ChunkFlattener::new(file).unwrap() {
        match record.unwrap() {
            Read::Schema { header, data } => {
                again.add_schema(&header.name, &header.encoding, &data).unwrap();
            }
            Read::Channel(channel) => {
                let (topic, encoding) = (&channel.topic, &channel.message_encoding);
                again.add_channel(channel.schema_id, topic, encoding, &channel.metadata).unwrap();
            }
            Read::Message { header, data } => again.write_to_known_channel(&header, &data).unwrap(),
            Read::Attachment { header, data, .. } => {
                let (log_time, create_time) = (header.log_time, header.create_time);
                let (name, media_type) = (header.name, header.media_type);
                again.attach(&Attachment { log_time, create_time, name, media_type, data }).unwrap();
            }
            _ => {}
        }
    }
    again.finish().unwrap();
    again.into_inner().into_inner()
}

#[test]
fn the_mcap_library_writes_the_same_file() {
    let empty = exported([]);
    assert_eq!(empty, written_again(&empty));

    let attached =
        |name: &str| CaptureRecord::Attachment { name: name.into(), content: name.repeat(100).into() };
    let started =
        CaptureRecord::Event(RunEvent::Started { unix_ns: 1_700_000_000_000_000_000, version: "1".into() });
    // More than one chunk, an attachment amid them, an empty one, and times that go back.
    let samples = |count: u32| {
        let sample = |at| Sample { sequence: Some(at), ..Sample::of(f64::from(at) / 1000.0) };
        CaptureRecord::Samples((0..count).map(sample).collect())
    };
    let gap =
        CaptureRecord::Event(RunEvent::Gap { seconds: Some(0.5), missing: None, reason: "gone".into() });
    let nothing = CaptureRecord::Attachment { name: "nothing".into(), content: Vec::new() };
    let records = [
        attached("plan.csv"),
        started,
        CaptureRecord::Raw(vec![1, 2, 255]),
        samples(9000),
        attached("robot.toml"),
        nothing,
        samples(20_000),
        gap,
    ];
    let file = exported(records);
    assert!(mcap::Summary::read(&file).unwrap().unwrap().chunk_indexes.len() > 3);
    assert!(file == written_again(&file), "the files differ");
}
