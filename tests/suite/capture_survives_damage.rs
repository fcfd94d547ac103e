//! A capture is read up to and past each damage, and each damage is named.

use std::path::Path;

use dbbd::capture::{self, Event, Record, Stamped, WriteError, Writer};
use dbbd::units::HostNs;
use proptest::prelude::*;

fn records() -> Vec<Stamped> {
    let records = vec![
        Record::Event(Event::Started { unix_ns: 1, version: "0".into() }),
        Record::Attachment { name: "plan.csv".into(), content: b"index\n1\n".to_vec() },
        Record::Raw(vec![0xdb, 0xbd, 0x5a, 0xa5, 2, 0, 0, 0, 0]),
        Record::Sample(b"{\"reading_mm\":0.1}".to_vec()),
        Record::Fault(b"{}".to_vec()),
        Record::Raw((0..=255).collect()),
        Record::Event(Event::Gap { seconds: Some(0.25), missing: None, reason: "r".into() }),
        Record::Event(Event::Ended { reason: "done".into(), samples: 1, lost: 0 }),
    ];
    let stamped =
        records.into_iter().zip(1u64..).map(|(record, at)| Stamped { host: HostNs(at << 40), record });
    stamped.collect()
}

fn write(path: &Path) -> (Vec<u8>, Vec<usize>) {
    let mut writer = Writer::create(path).unwrap();
    let mut ends = vec![std::fs::metadata(path).unwrap().len() as usize];
    for stamped in records() {
        writer.write(stamped.host, &stamped.record).unwrap();
        ends.push(std::fs::metadata(path).unwrap().len() as usize);
    }
    (std::fs::read(path).unwrap(), ends)
}

fn written() -> (Vec<u8>, Vec<usize>) {
    write(&tempfile::tempdir().unwrap().path().join("run"))
}

#[test]
fn what_was_written_is_read() {
    let (bytes, _) = written();
    let capture = capture::read(&bytes);
    assert_eq!(capture.records, records());
    assert_eq!(capture.damages, []);
    assert!(capture.ended());
    assert_eq!(capture.attachment("plan.csv"), Some(&b"index\n1\n"[..]));
}

#[test]
fn a_capture_is_never_overwritten() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (bytes, _) = write(&path);
    assert!(matches!(Writer::create(&path), Err(WriteError::Exists(_))));
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
}

#[test]
fn cut_at_every_byte_it_is_a_prefix_and_the_tail_is_named() {
    let (bytes, ends) = written();
    for cut in 0..=bytes.len() {
        let capture = capture::read(&bytes[..cut]);
        let whole = ends.iter().filter(|end| **end <= cut).count().saturating_sub(1);
        assert_eq!(capture.records, records()[..whole], "cut at {cut}");
        if cut == 0 || ends.contains(&cut) {
            assert_eq!(capture.damages, [], "cut at {cut}");
        } else {
            let [damage] = &capture.damages[..] else { panic!("cut at {cut}: {:?}", capture.damages) };
            assert_eq!((damage.offset + damage.bytes) as usize, cut);
            assert!(cut < ends[0] || damage.what.starts_with("torn tail"), "cut at {cut}: {}", damage.what);
        }
    }
}

#[test]
fn every_flipped_bit_costs_one_record_and_is_named() {
    let (bytes, ends) = written();
    for bit in 0..8 * bytes.len() {
        let mut bytes = bytes.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let capture = capture::read(&bytes);
        let harmed = ends.iter().filter(|end| **end <= bit / 8).count();
        let mut expected = records();
        if harmed > 0 {
            expected.remove(harmed - 1);
        }
        assert_eq!(capture.records, expected, "bit {bit}");
        let [damage] = &capture.damages[..] else { panic!("bit {bit}: {:?}", capture.damages) };
        let start = if harmed == 0 { 0 } else { ends[harmed - 1] };
        assert_eq!(
            (damage.offset as usize, damage.bytes as usize),
            (start, ends[harmed] - start),
            "bit {bit}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_read(head in prop::collection::vec(any::<u8>(), 0..200), from in 0usize..400, to in 0usize..400) {
        let (bytes, _) = written();
        let (from, to) = (from.min(bytes.len()), to.min(bytes.len()));
        let spliced = [&bytes[..from], &head[..], &bytes[to..]].concat();
        let capture = capture::read(&spliced);
        let damaged: u64 = capture.damages.iter().map(|damage| damage.bytes).sum();
        prop_assert!(damaged <= spliced.len() as u64);
        capture::read(&head);
    }
}
