//! The MCAP container (<https://mcap.dev/spec>): uncompressed chunks with their indexes, attachments, a summary, checksums.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::mem;

use crc::{CRC_32_ISO_HDLC, Crc, Digest, Table};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// A chunk ends before the next message if it is longer than this, bytes.
const CHUNK: usize = 1 << 20;
static CRC_32: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// The opcode of a record.
#[derive(Clone, Copy)]
enum Kind {
    Header = 0x01,
    Footer = 0x02,
    Schema = 0x03,
    Channel = 0x04,
    Message = 0x05,
    Chunk = 0x06,
    MessageIndex = 0x07,
    ChunkIndex = 0x08,
    Attachment = 0x09,
    AttachmentIndex = 0x0A,
    Statistics = 0x0B,
    SummaryOffset = 0x0E,
    DataEnd = 0x0F,
}

/// The form of the messages of a channel.
#[derive(Clone, Copy)]
pub(super) enum MessageEncoding {
    Json,
    Protobuf,
}

impl MessageEncoding {
    /// The names of the encodings of the schema and of the messages.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Json => ("jsonschema", "json"),
            Self::Protobuf => ("protobuf", "protobuf"),
        }
    }
}

/// The serialised fields of a record.
#[derive(Default)]
struct Fields(Vec<u8>);

impl Fields {
    fn u16(mut self, value: u16) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Adds the number of bytes, then the bytes.
    fn bytes(self, bytes: &[u8]) -> Self {
        let mut fields = self.u32(bytes.len() as u32);
        fields.0.extend(bytes);
        fields
    }

    fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    /// The record with these fields and `further` bytes.
    fn append_to(&self, to: &mut Vec<u8>, kind: Kind, further: &[u8]) {
        to.push(kind as u8);
        to.extend(((self.0.len() + further.len()) as u64).to_le_bytes());
        to.extend(&self.0);
        to.extend(further);
    }

    fn record(&self, kind: Kind) -> Vec<u8> {
        let mut record = Vec::new();
        self.append_to(&mut record, kind, &[]);
        record
    }
}

/// The earliest and the latest time of messages, ns; 0 without a message.
#[derive(Clone, Copy, Default)]
struct Span(Option<(u64, u64)>);

impl Span {
    fn add(&mut self, at_ns: u64) {
        let (first, last) = self.0.unwrap_or((at_ns, at_ns));
        self.0 = Some((first.min(at_ns), last.max(at_ns)));
    }

    fn ends(self) -> (u64, u64) {
        self.0.unwrap_or_default()
    }
}

/// Records that are written together.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    span: Span,
    /// For each channel the time of each message and its offset in the records.
    indexes: BTreeMap<u16, Fields>,
}

/// Records of one kind for the summary.
#[derive(Default)]
struct Group {
    records: Vec<u8>,
    count: u32,
}

impl Group {
    fn add(&mut self, fields: &Fields, kind: Kind) {
        fields.append_to(&mut self.records, kind, &[]);
        self.count += 1;
    }
}

pub(super) struct Attachment<'a> {
    pub(super) at_ns: u64,
    pub(super) name: &'a str,
    pub(super) media_type: &'a str,
    pub(super) data: &'a [u8],
}

/// A file that is being written.
pub(super) struct Container<W> {
    to: W,
    /// Bytes written, and their checksum.
    position: u64,
    check: Digest<'static, u32, Table<16>>,
    chunk: Chunk,
    span: Span,
    /// Number of messages of each channel that has messages.
    messages: BTreeMap<u16, u64>,
    schemas: Group,
    channels: Group,
    chunk_indexes: Group,
    attachment_indexes: Group,
}

impl<W: Write> Container<W> {
    pub(super) fn new(to: W, library: &str) -> io::Result<Self> {
        let mut file = Self {
            to,
            position: 0,
            check: CRC_32.digest(),
            chunk: Chunk::default(),
            span: Span::default(),
            messages: BTreeMap::new(),
            schemas: Group::default(),
            channels: Group::default(),
            chunk_indexes: Group::default(),
            attachment_indexes: Group::default(),
        };
        file.put(MAGIC)?;
        file.put(&Fields::default().text("").text(library).record(Kind::Header))?;
        Ok(file)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check.update(bytes);
        self.position += bytes.len() as u64;
        self.to.write_all(bytes)
    }

    /// Adds a channel with the schema of its messages; returns its number.
    pub(super) fn add_channel(
        &mut self,
        topic: &str,
        encoding: MessageEncoding,
        schema_name: &str,
        schema: &[u8],
    ) -> u16 {
        let id = self.channels.count as u16 + 1;
        let (of_schema, of_message) = encoding.names();
        let schema = Fields::default().u16(id).text(schema_name).text(of_schema).bytes(schema);
        let channel = Fields::default().u16(id).u16(id).text(topic).text(of_message).bytes(&[]);
        schema.append_to(&mut self.chunk.records, Kind::Schema, &[]);
        channel.append_to(&mut self.chunk.records, Kind::Channel, &[]);
        self.schemas.add(&schema, Kind::Schema);
        self.channels.add(&channel, Kind::Channel);
        id
    }

    pub(super) fn message(&mut self, channel: u16, sequence: u32, at_ns: u64, data: &[u8]) -> io::Result<()> {
        if self.chunk.records.len() > CHUNK {
            self.finish_chunk()?;
        }
        let chunk = &mut self.chunk;
        let index = chunk.indexes.remove(&channel).unwrap_or_default();
        chunk.indexes.insert(channel, index.u64(at_ns).u64(chunk.records.len() as u64));
        let fields = Fields::default().u16(channel).u32(sequence).u64(at_ns).u64(at_ns);
        fields.append_to(&mut chunk.records, Kind::Message, data);
        chunk.span.add(at_ns);
        self.span.add(at_ns);
        *self.messages.entry(channel).or_default() += 1;
        Ok(())
    }

    pub(super) fn attach(&mut self, attachment: &Attachment<'_>) -> io::Result<()> {
        self.finish_chunk()?;
        let &Attachment { at_ns, name, media_type, data } = attachment;
        let (begin, bytes) = (self.position, data.len() as u64);
        let mut fields = Fields::default().u64(at_ns).u64(at_ns).text(name).text(media_type).u64(bytes);
        fields.0.extend(data);
        let check = CRC_32.checksum(&fields.0);
        self.put(&fields.u32(check).record(Kind::Attachment))?;
        let index = Fields::default().u64(begin).u64(self.position - begin).u64(at_ns).u64(at_ns).u64(bytes);
        self.attachment_indexes.add(&index.text(name).text(media_type), Kind::AttachmentIndex);
        Ok(())
    }

    fn finish_chunk(&mut self) -> io::Result<()> {
        let Chunk { records, span, indexes } = mem::take(&mut self.chunk);
        if records.is_empty() {
            return Ok(());
        }
        let (begin, bytes, (first, last)) = (self.position, records.len() as u64, span.ends());
        let head = Fields::default().u64(first).u64(last).u64(bytes).u32(CRC_32.checksum(&records));
        let mut chunk = Vec::with_capacity(records.len() + 100);
        head.text("").u64(bytes).append_to(&mut chunk, Kind::Chunk, &records);
        self.put(&chunk)?;
        let end = self.position;
        let mut places = Fields::default();
        for (channel, index) in indexes {
            places = places.u16(channel).u64(self.position);
            self.put(&Fields::default().u16(channel).bytes(&index.0).record(Kind::MessageIndex))?;
        }
        let index = Fields::default().u64(first).u64(last).u64(begin).u64(end - begin).bytes(&places.0);
        let index = index.u64(self.position - end).text("").u64(bytes).u64(bytes);
        self.chunk_indexes.add(&index, Kind::ChunkIndex);
        Ok(())
    }

    fn statistics(&self) -> Fields {
        let counts = self.messages.iter();
        let counts =
            counts.fold(Fields::default(), |fields, (channel, count)| fields.u16(*channel).u64(*count));
        let (first, last) = self.span.ends();
        let fields = Fields::default().u64(self.messages.values().sum()).u16(self.schemas.count as u16);
        let fields = fields.u32(self.channels.count).u32(self.attachment_indexes.count).u32(0);
        fields.u32(self.chunk_indexes.count).u64(first).u64(last).bytes(&counts.0)
    }

    /// Writes the rest of the records, and the summary.
    pub(super) fn finish(mut self) -> io::Result<()> {
        self.finish_chunk()?;
        let check = self.check.clone().finalize();
        self.put(&Fields::default().u32(check).record(Kind::DataEnd))?;
        let begin = self.position;
        let statistics = self.statistics().record(Kind::Statistics);
        let groups = [
            (Kind::Schema, &self.schemas.records),
            (Kind::Channel, &self.channels.records),
            (Kind::Statistics, &statistics),
            (Kind::ChunkIndex, &self.chunk_indexes.records),
            (Kind::AttachmentIndex, &self.attachment_indexes.records),
        ];
        let (mut summary, mut offsets) = (Vec::new(), Vec::new());
        for (kind, records) in groups.into_iter().filter(|(_, records)| !records.is_empty()) {
            let place = Fields(vec![kind as u8]).u64(begin + summary.len() as u64);
            place.u64(records.len() as u64).append_to(&mut offsets, Kind::SummaryOffset, &[]);
            summary.extend(records);
        }
        let offsets_begin = begin + summary.len() as u64;
        summary.extend(offsets);
        // The checksum covers the footer up to the checksum itself.
        let footer = Fields::default().u64(begin).u64(offsets_begin).u32(0).record(Kind::Footer);
        summary.extend(&footer[..footer.len() - 4]);
        let check = CRC_32.checksum(&summary);
        self.to.write_all(&summary)?;
        self.to.write_all(&check.to_le_bytes())?;
        self.to.write_all(MAGIC)?;
        self.to.flush()
    }
}
