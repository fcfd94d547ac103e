//! The certificate as PDF/A-3b with the DCC embedded: A4, with headers and footers; table heads repeat on every page.

use std::fmt::Display;

use krilla::configure::{Archival, ConfigurationBuilder};
use krilla::embed::{AssociationKind, EmbeddedFile, MimeType};
use krilla::geom::{PathBuilder, Point};
use krilla::metadata::{DateTime, Metadata};
use krilla::page::PageSettings;
use krilla::paint::Stroke;
use krilla::text::{Font, GlyphId, KrillaGlyph};
use krilla::{Document, SerializeSettings};
use skrifa::charmap::Charmap;
use skrifa::instance::{LocationRef, Size};
use skrifa::metrics::GlyphMetrics;
use skrifa::{FontRef, MetadataProvider};

use super::Certificate;
use super::sections::{Block, Section, Table};
use crate::report::certificate::CertificateFinding;

/// Size of A4 and its margins, points.
const PAGE: [f32; 2] = [595.28, 841.89];
const LEFT: f32 = 51.0;
const RIGHT: f32 = PAGE[0] - 51.0;
const TOP: f32 = 78.0;
const BOTTOM: f32 = PAGE[1] - 62.0;
/// Line spacing in font sizes.
const LEADING: f32 = 1.4;
/// Gap between columns, and width of the column of names, points.
const GAP: f32 = 10.0;
const NAMES: f32 = 165.0;

const TITLE: Style = Style { size: 17.0, weight: Weight::Bold };
const HEADING: Style = Style { size: 11.5, weight: Weight::Bold };
const BODY: Style = Style { size: 9.0, weight: Weight::Regular };
const STRONG: Style = Style { size: 9.0, weight: Weight::Bold };
const SMALL: Style = Style { size: 7.5, weight: Weight::Regular };

#[derive(Clone, Copy)]
enum Weight {
    Regular,
    Bold,
}

#[derive(Clone, Copy)]
struct Style {
    size: f32,
    weight: Weight,
}

/// A mark on a page, in points from the upper left corner.
enum Mark {
    Text { at: [f32; 2], style: Style, text: String },
    Rule { y: f32, from: f32, to: f32 },
}

/// The glyph of each character of a font, and its advance. Text is set without kerning and ligatures, so that the width of a
/// text is the sum of its advances.
struct Typeface {
    charmap: Charmap<'static>,
    /// The metrics of the glyphs, in units of the font.
    metrics: GlyphMetrics<'static>,
    units_per_em: f32,
}

impl Typeface {
    fn new(data: &'static [u8]) -> Result<Self, CertificateFinding> {
        let font = FontRef::new(data).map_err(failed)?;
        let (size, location) = (Size::unscaled(), LocationRef::default());
        let units_per_em = f32::from(font.metrics(size, location).units_per_em);
        Ok(Self { charmap: font.charmap(), metrics: font.glyph_metrics(size, location), units_per_em })
    }

    /// The glyphs of a text; characters that the font lacks are left out.
    fn glyphs(&self, text: &str) -> Vec<KrillaGlyph> {
        let glyph = |(at, c): (usize, char)| {
            let glyph = self.charmap.map(c)?;
            let advance = self.metrics.advance_width(glyph)? / self.units_per_em;
            let covers = at..at + c.len_utf8();
            Some(KrillaGlyph::new(GlyphId::new(glyph.to_u32()), advance, 0.0, 0.0, 0.0, covers, None))
        };
        text.char_indices().filter_map(glyph).collect()
    }
}

struct Letters {
    regular: Typeface,
    bold: Typeface,
}

impl Letters {
    fn new() -> Result<Self, CertificateFinding> {
        let (regular, bold) = (dejavu::sans::regular(), dejavu::sans::bold());
        Ok(Self { regular: Typeface::new(regular)?, bold: Typeface::new(bold)? })
    }

    fn face(&self, weight: Weight) -> &Typeface {
        match weight {
            Weight::Regular => &self.regular,
            Weight::Bold => &self.bold,
        }
    }

    fn width(&self, text: &str, style: Style) -> f32 {
        let glyphs = self.face(style.weight).glyphs(text);
        glyphs.iter().map(|glyph| glyph.x_advance).sum::<f32>() * style.size
    }

    /// The text in lines of at most `width` points; a longer word is broken.
    fn wrapped(&self, text: &str, style: Style, width: f32) -> Vec<String> {
        let mut lines = vec![String::new()];
        for word in text.split_whitespace() {
            let mut rest = word;
            loop {
                let line = lines.last_mut().map_or_else(String::new, std::mem::take);
                let joined = if line.is_empty() { rest.to_owned() } else { format!("{line} {rest}") };
                if self.width(&joined, style) <= width {
                    lines.pop();
                    lines.push(joined);
                    break;
                }
                lines.pop();
                if !line.is_empty() {
                    lines.extend([line, String::new()]);
                    continue;
                }
                let ends = rest.char_indices().map(|(at, c)| at + c.len_utf8());
                let fits = ends.take_while(|end| self.width(&rest[..*end], style) <= width).last();
                let end = fits.unwrap_or_else(|| rest.chars().next().map_or(0, char::len_utf8));
                lines.extend([rest[..end].to_owned(), String::new()]);
                rest = &rest[end..];
                if rest.is_empty() {
                    break;
                }
            }
        }
        lines
    }

    /// The first character that the font lacks.
    fn lacks(&self, text: &str) -> Option<char> {
        text.chars().find(|c| self.regular.charmap.map(*c).is_none())
    }
}

/// The cells of a row, in lines.
type Row = Vec<Vec<String>>;

struct TableRows {
    widths: Vec<f32>,
    head: Row,
    rows: Vec<Row>,
    /// Height that stays on one page, points: the height of the whole table if it is short.
    together: f32,
}

struct Layout {
    letters: Letters,
    pages: Vec<Vec<Mark>>,
    y: f32,
}

impl Layout {
    /// Begins a new page if fewer points than `height` are left; returns whether it did.
    fn room(&mut self, height: f32) -> bool {
        let full = self.pages.is_empty() || self.y + height > BOTTOM;
        if full {
            self.pages.push(Vec::new());
            self.y = TOP;
        }
        full
    }

    fn mark(&mut self, mark: Mark) {
        if let Some(page) = self.pages.last_mut() {
            page.push(mark);
        }
    }

    fn lines(&mut self, lines: &[String], x: f32, style: Style) {
        for (at, line) in lines.iter().enumerate() {
            let y = self.y + style.size * (1.0 + LEADING * at as f32);
            self.mark(Mark::Text { at: [x, y], style, text: line.clone() });
        }
    }

    fn paragraph(&mut self, text: &str, style: Style) {
        let lines = self.letters.wrapped(text, style, RIGHT - LEFT);
        let height = style.size * LEADING * lines.len() as f32;
        self.room(height);
        self.lines(&lines, LEFT, style);
        self.y += height + 0.4 * style.size;
    }

    fn section(&mut self, number: usize, section: &Section) {
        // No heading alone at the end of a page.
        let follows = match section.blocks.first() {
            Some(Block::Table(table)) => self.table_rows(table).together,
            _ => 4.0 * BODY.size,
        };
        self.room(HEADING.size * LEADING + 12.0 + follows);
        self.y += 8.0;
        self.paragraph(&format!("{number} {}", section.title), HEADING);
        for block in &section.blocks {
            match block {
                Block::Text(text) => self.paragraph(text, BODY),
                Block::Facts(facts) => facts.iter().for_each(|(name, value)| self.fact(name, value)),
                Block::Table(table) => self.table(table),
                Block::Signatures(names) => self.signatures(names),
            }
        }
    }

    fn fact(&mut self, name: &str, value: &str) {
        let names = self.letters.wrapped(&super::capitalised(name), SMALL, NAMES - GAP);
        let values = self.letters.wrapped(value, BODY, RIGHT - LEFT - NAMES);
        let height = BODY.size * LEADING * names.len().max(values.len()) as f32;
        self.room(height);
        self.lines(&names, LEFT, SMALL);
        self.lines(&values, LEFT + NAMES, BODY);
        self.y += height;
    }

    fn table(&mut self, table: &Table) {
        let TableRows { widths, head, rows, together } = self.table_rows(table);
        self.room(together);
        self.row(&head, table, &widths, SMALL);
        for (at, row) in rows.iter().enumerate() {
            if self.room(height(row)) {
                self.row(&head, table, &widths, SMALL);
            }
            let last = at + 1 == rows.len() && table.sum;
            self.row(row, table, &widths, if last { STRONG } else { BODY });
        }
        self.y += 6.0;
    }

    fn table_rows(&self, table: &Table) -> TableRows {
        let widths = self.widths(table);
        let titles: Vec<String> = table.head.iter().map(|head| head.title.to_owned()).collect();
        let head = self.cells(&titles, &widths, SMALL);
        let rows: Vec<Row> = table.rows.iter().map(|row| self.cells(row, &widths, STRONG)).collect();
        let whole: f32 = rows.iter().chain([&head]).map(|row| height(row)).sum();
        let together = if whole < 0.5 * (BOTTOM - TOP) { whole } else { height(&head) + 30.0 };
        TableRows { widths, head, rows, together }
    }

    fn cells(&self, row: &[String], widths: &[f32], style: Style) -> Vec<Vec<String>> {
        let cells = row.iter().zip(widths);
        cells.map(|(text, width)| self.letters.wrapped(text, style, *width)).collect()
    }

    fn row(&mut self, cells: &[Vec<String>], table: &Table, widths: &[f32], style: Style) {
        let mut x = LEFT;
        for ((lines, width), head) in cells.iter().zip(widths).zip(&table.head) {
            for (at, line) in lines.iter().enumerate() {
                let shift = if head.number { width - self.letters.width(line, style) } else { 0.0 };
                let y = self.y + 2.0 + BODY.size * (1.0 + LEADING * at as f32);
                self.mark(Mark::Text { at: [x + shift, y], style, text: line.clone() });
            }
            x += width + GAP;
        }
        self.y += height(cells);
        self.mark(Mark::Rule { y: self.y, from: LEFT, to: RIGHT });
    }

    /// Columns of numbers get their natural width; columns of text share the rest.
    fn widths(&self, table: &Table) -> Vec<f32> {
        let columns = table.head.len();
        let natural: Vec<f32> = (0..columns)
            .map(|at| {
                let cells = table.rows.iter().filter_map(|row| row.get(at));
                let cells = cells.map(|cell| self.letters.width(cell, STRONG));
                cells.chain([self.letters.width(table.head[at].title, SMALL)]).fold(0.0, f32::max) + 1.0
            })
            .collect();
        let room = RIGHT - LEFT - GAP * columns.saturating_sub(1) as f32;
        let of = |number: bool| {
            let own = natural.iter().zip(&table.head).filter(move |(_, head)| head.number == number);
            own.map(|(width, _)| *width).sum::<f32>()
        };
        let scale = (room - of(true)) / of(false).max(1.0);
        let width =
            |(width, head): (&f32, &super::sections::Head)| if head.number { *width } else { width * scale };
        natural.iter().zip(&table.head).map(width).collect()
    }

    fn signatures(&mut self, names: &[&str]) {
        self.room(80.0);
        self.y += 55.0;
        let width = (RIGHT - LEFT - 40.0) / names.len().max(1) as f32;
        for (at, name) in names.iter().enumerate() {
            let from = LEFT + (width + 40.0) * at as f32;
            self.mark(Mark::Rule { y: self.y, from, to: from + width });
            let at = [from, self.y + 11.0];
            self.mark(Mark::Text { at, style: SMALL, text: (*name).to_owned() });
        }
        self.y += 20.0;
    }

    /// Header and footer of each page.
    fn margins(&mut self, certificate: &Certificate) {
        let count = self.pages.len();
        for (at, page) in self.pages.iter_mut().enumerate() {
            let number = format!("Page {} of {count}", at + 1);
            let foot = format!("Draft {}, measured {}", certificate.number(), certificate.measured());
            let mut put = |text: &str, right: bool, y: f32| {
                let shift = if right { self.letters.width(text, SMALL) } else { 0.0 };
                let x = if right { RIGHT - shift } else { LEFT };
                page.push(Mark::Text { at: [x, y], style: SMALL, text: text.to_owned() });
            };
            put(&certificate.result.robot, false, 44.0);
            put(certificate.draft(), true, 44.0);
            put(&foot, false, PAGE[1] - 34.0);
            put(&number, true, PAGE[1] - 34.0);
            page.push(Mark::Rule { y: 50.0, from: LEFT, to: RIGHT });
        }
    }
}

fn height(cells: &[Vec<String>]) -> f32 {
    let lines = cells.iter().map(Vec::len).max().unwrap_or(1);
    BODY.size * LEADING * lines as f32 + 3.0
}

fn failed(why: impl Display) -> CertificateFinding {
    CertificateFinding::PdfFailed { why: why.to_string() }
}

pub(super) fn write(certificate: &Certificate, dcc: &[u8]) -> Result<Vec<u8>, CertificateFinding> {
    let mut layout = Layout { letters: Letters::new()?, pages: Vec::new(), y: TOP };
    layout.room(0.0);
    layout.paragraph(&certificate.title(), TITLE);
    layout.paragraph(certificate.draft(), STRONG);
    for (at, section) in certificate.sections().iter().enumerate() {
        layout.section(at + 1, section);
    }
    layout.margins(certificate);
    for mark in layout.pages.iter().flatten() {
        if let Mark::Text { text, .. } = mark
            && let Some(character) = layout.letters.lacks(text)
        {
            return Err(failed(format_args!(
                "its font has no `{character}` (U+{:04X})",
                u32::from(character)
            )));
        }
    }
    draw(&layout, certificate, dcc)
}

fn draw(layout: &Layout, certificate: &Certificate, dcc: &[u8]) -> Result<Vec<u8>, CertificateFinding> {
    let configuration = ConfigurationBuilder::new().with_archival_validator(Archival::A3_B).finish();
    let configuration = configuration.map_err(|error| failed(format_args!("{error:?}")))?;
    let settings = SerializeSettings { configuration, enable_tagging: false, ..SerializeSettings::default() };
    let mut document = Document::new_with(settings);
    let font =
        |data: &'static [u8]| Font::new(data.into(), 0).ok_or_else(|| failed("the font cannot be read"));
    let (regular, bold) = (font(dejavu::sans::regular())?, font(dejavu::sans::bold())?);
    for marks in &layout.pages {
        let size = PageSettings::from_wh(PAGE[0], PAGE[1]).ok_or_else(|| failed("no page"))?;
        let mut page = document.start_page_with(size);
        let mut surface = page.surface();
        for mark in marks {
            match mark {
                Mark::Text { at: [x, y], style, text } => {
                    let font = match style.weight {
                        Weight::Regular => regular.clone(),
                        Weight::Bold => bold.clone(),
                    };
                    surface.set_stroke(None);
                    let at = Point::from_xy(*x, *y);
                    let glyphs = layout.letters.face(style.weight).glyphs(text);
                    surface.draw_glyphs(at, &glyphs, font, text, style.size, false);
                }
                Mark::Rule { y, from, to } => {
                    let mut path = PathBuilder::new();
                    path.move_to(*from, *y);
                    path.line_to(*to, *y);
                    surface.set_stroke(Some(Stroke { width: 0.4, ..Stroke::default() }));
                    path.finish().iter().for_each(|path| surface.draw_path(path));
                }
            }
        }
        surface.finish();
        page.finish();
    }
    let date = date(certificate);
    let metadata = Metadata::new().title(certificate.title()).language("en".into());
    document.set_metadata(metadata.creator("dbbd".into()).creation_date(date));
    let embedded = document.embed_file(EmbeddedFile {
        path: "dcc.xml".into(),
        mime_type: MimeType::new("application/xml"),
        description: Some("Digital calibration certificate, DCC 3.3.0, draft".into()),
        association_kind: AssociationKind::Data,
        data: dcc.to_vec().into(),
        modification_date: Some(date),
        compress: Some(true),
        location: None,
    });
    embedded.ok_or_else(|| failed("dcc.xml cannot be embedded"))?;
    document.finish().map_err(|error| failed(format_args!("{error:?}")))
}

/// The date of the measurement, so that the same result gives the same bytes.
fn date(certificate: &Certificate) -> DateTime {
    let part = |range| certificate.measured().get(range).and_then(|digits: &str| digits.parse::<u16>().ok());
    let small = |range| part(range).and_then(|value| u8::try_from(value).ok()).unwrap_or(1);
    DateTime::new(part(0..4).unwrap_or(1)).month(small(5..7)).day(small(8..10))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Advances of DejaVu Sans 2.37 in units of 2048 (its table `hmtx`): 0 has 1303, A 1401, \u{b1} 1716; of the bold face, A
    /// has 1585.
    #[test]
    fn width_of_a_text_is_the_sum_of_its_advances() {
        let letters = Letters::new().unwrap();
        for (text, style, units) in
            [("0A\u{b1}", BODY, 1303 + 1401 + 1716), ("AA", STRONG, 2 * 1585), ("", BODY, 0)]
        {
            let expected = units as f32 / 2048.0 * 9.0;
            assert!((letters.width(text, style) - expected).abs() < 1e-4, "{text}");
        }
        assert_eq!(letters.lacks("A\u{e000}0"), Some('\u{e000}'));
    }

    #[test]
    fn glyphs_cover_the_bytes_of_their_characters() {
        let letters = Letters::new().unwrap();
        let glyphs = letters.face(Weight::Regular).glyphs("\u{b5}m");
        let ranges: Vec<_> = glyphs.iter().map(|glyph| glyph.text_range.clone()).collect();
        assert_eq!(ranges, [0..2, 2..3]);
    }

    #[test]
    fn wrapped_lines_fit_and_keep_the_text() {
        let letters = Letters::new().unwrap();
        let text = "the position uncertainty of a robot with a verylongwordthatmustbebroken in it";
        let lines = letters.wrapped(text, BODY, 80.0);
        assert!(lines.len() > 3 && lines.iter().all(|line| letters.width(line, BODY) <= 80.0));
        let plain = |text: &str| text.replace(' ', "");
        assert_eq!(plain(&lines.concat()), plain(text));
    }
}
