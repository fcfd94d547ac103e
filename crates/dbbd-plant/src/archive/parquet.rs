//! Export of tables as Parquet files.

use std::sync::Arc;

use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;
use serde::Serialize;
use serde_json::Value;

use dbbd_model::base::InternalFinding;

/// Type of a column. Every column is nullable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    Text,
    Integer,
    Real,
    Flag,
}

impl ColumnKind {
    fn field(self, name: &str) -> String {
        match self {
            Self::Text => format!("optional binary {name} (STRING); "),
            Self::Integer => format!("optional int64 {name}; "),
            Self::Real => format!("optional double {name}; "),
            Self::Flag => format!("optional boolean {name}; "),
        }
    }
}

/// The content of a Parquet file. The rows serialise to objects with a field per column.
pub fn parquet(
    columns: &[(&str, ColumnKind)],
    rows: impl IntoIterator<Item = impl Serialize>,
) -> Result<Vec<u8>, InternalFinding> {
    let unfit = |why: String| InternalFinding::NotWritten { form: "Parquet", why };
    let mut cells: Vec<Vec<Value>> = vec![Vec::new(); columns.len()];
    for row in rows {
        let mut row = serde_json::to_value(row).map_err(|error| unfit(error.to_string()))?;
        for ((name, _), cells) in columns.iter().zip(&mut cells) {
            cells.push(row.get_mut(name).map(Value::take).ok_or_else(|| unfit(format!("no field {name}")))?);
        }
    }
    file(columns, &cells).map_err(|error| unfit(error.to_string()))
}

fn file(columns: &[(&str, ColumnKind)], cells: &[Vec<Value>]) -> Result<Vec<u8>, ParquetError> {
    let fields: String = columns.iter().map(|(name, kind)| kind.field(name)).collect();
    let schema = Arc::new(parse_message_type(&format!("message table {{ {fields}}}"))?);
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(WriterProperties::default()))?;
    let mut group = writer.next_row_group()?;
    for ((_, kind), cells) in columns.iter().zip(cells) {
        let Some(column) = group.next_column()? else { break };
        match kind {
            ColumnKind::Text => {
                write_column::<ByteArrayType>(column, cells, |cell| cell.as_str().map(ByteArray::from))
            }
            ColumnKind::Integer => write_column::<Int64Type>(column, cells, Value::as_i64),
            ColumnKind::Real => write_column::<DoubleType>(column, cells, Value::as_f64),
            ColumnKind::Flag => write_column::<BoolType>(column, cells, Value::as_bool),
        }?;
    }
    group.close()?;
    writer.into_inner()
}

fn write_column<T: DataType>(
    mut column: SerializedColumnWriter<'_>,
    cells: &[Value],
    of: impl Fn(&Value) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let given = cells.iter().filter(|cell| !cell.is_null());
    let values: Vec<T::T> =
        given.map(|cell| of(cell).ok_or_else(|| other(cell))).collect::<Result<_, _>>()?;
    let present: Vec<i16> = cells.iter().map(|cell| i16::from(!cell.is_null())).collect();
    column.typed::<T>().write_batch(&values, Some(&present), None)?;
    column.close()
}

fn other(cell: &Value) -> ParquetError {
    ParquetError::General(format!("{cell} does not have the type of its column"))
}
