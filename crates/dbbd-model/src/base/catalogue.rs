//! Files: read, written, and what any table or TOML file contains.

use crate::findings;

findings! {
    /// A file that cannot be read or written, or whose text is not what it should be.
    FileFinding "Files" {
        E0101 "a file cannot be read",
        cause: "The path is wrong, it is a directory or no file at all, this user may not read it, or the file is larger than any of its kind.",
        cure: "Check the path. On Linux `ls -l` shows the rights, on Windows the file's properties." {
            Unreadable { why: String } => "cannot be read: {why}";
            NotAFile => "is not a file";
            TooLarge { bytes: u64, most: u64 } => "has {bytes} bytes: at most {most} are read";
        }
        E0102 "a file cannot be written",
        cause: "The directory does not exist, the disk is full, another program has the file open, this user may not write there, or the file is the one that is read.",
        cure: "Check the path of the result, the free space and the rights; close the program that shows the file.",
        asks: [Out] {
            Unwritable { why: String } => "cannot be written: {why}";
            NoDirectory { why: String } => "cannot be made: {why}";
            StandardOutput => "is no file: results are not written to standard output";
            IsRead => "is read by this command: name another directory for the result";
        }
        E0182 "a file of an earlier result would be replaced",
        cause: "The directory has a file of this name, from an earlier run of the command or from elsewhere: a program, a table or a URDF that may be in use.",
        cure: "Name another directory, or replace the files explicitly.",
        asks: [Out, Replace] {
            Exists => "exists, and is not replaced";
        }
        E0103 "a file is not text",
        cause: "The file is binary, or in an encoding that is not read here: tables are UTF-8, UTF-16 or Windows-1252, other files UTF-8; lines end with a line feed, with or without a carriage return before it.",
        cure: "Save it as UTF-8 (a table: \"CSV UTF-8\"). A capture is read by `dbbd info`, `sync`, `identify`, `circle` and `export` only." {
            NotUtf8 => "is not UTF-8 text";
            NotText { encoding: String } => "is not text in {encoding}";
            CarriageReturns => "its lines end with a carriage return alone";
            NotUtf8At { byte: usize } => "is not UTF-8 text (byte {byte})";
        }
        E0110 "a table lacks a column",
        cause: "The header does not name all columns that are needed, names one twice, or writes a name with other capital letters.",
        cure: "Compare the header with the columns that the command's help lists; the order of columns is free." {
            NoText => "is empty: a table begins with the names of its columns";
            MissingColumns { absent: String, header: String, delimiter: String } => "there is no column {absent}", help: "the header, cut at {delimiter}, has: {header}";
            OtherCase { column: String, name: String } => "`{column}` is not the column `{name}`: capital and small letters differ";
            ColumnTwice { column: String } => "the column `{column}` is there twice";
        }
        E0111 "a cell of a table is not what its column needs",
        cause: "The cell is empty, holds text, a number with another decimal than those before or with thousands separated, or its number is outside of what the column can mean.",
        cure: "Correct the cell. The first number with a decimal point or comma shows which one the table has; units are in the column's name." {
            NotFinite { column: String, cell: String } => "column `{column}`: `{cell}`: is not a finite number";
            NotANumber { column: String, cell: String } => "column `{column}`: `{cell}`: is not a number";
            OtherDecimal { column: String, cell: String, decimal: char } => "column `{column}`: `{cell}`: the numbers of this table have the decimal `{decimal}`";
            NotACell { column: usize, why: String } => "column {column}: {why}";
            NotPositive { column: String, cell: String } => "column `{column}`: `{cell}`: must be positive";
            NotWhole { column: String, cell: String, least: u32 } => "column `{column}`: `{cell}`: must be a whole number from {least}";
        }
        E0112 "a row of a table does not match its header",
        cause: "A row has more or fewer cells than the header, or a quote is not closed. Decimal commas in a table whose cells are separated by commas give too many cells.",
        cure: "Open the line in a text editor. Cells are separated by semicolons, tabs or commas; numbers with a decimal comma need one of the first two, or quotes." {
            CellCount { cells: usize, columns: usize, delimiter: String } => "the row, cut at {delimiter}, has {cells} cells, and the header {columns}";
            NoCell { column: usize } => "the line ends before its column {column}";
            OpenQuote => "a quote is not closed";
            NotCsv => "is not well-formed CSV";
        }
        E0120 "a TOML file cannot be read",
        cause: "The text is not TOML, a key is unknown or has the wrong type, or a key is missing.",
        cure: "The message marks the place. The shipped examples show every key." {
            NotToml { why: String } => "{why}";
            NotTomlButAnother { why: String, kind: String } => "{why}", help: "a .toml file is read here: is a .{kind} meant?";
            DecimalComma { why: String } => "{why}", help: "numbers have a decimal point, not a comma";
        }
        E0121 "an array of a TOML file has too few or too many values",
        cause: "A value is missing or is there twice, or the numbers are written with decimal commas: `[45,5, 0,0]` has four values.",
        cure: "Write as many values as the message says, with decimal points: `[45.5, 0.0]`." {
            ArrayLength { found: usize, expected: usize } => "the array has {found} values, and {expected} are needed";
            ArrayLengthByComma { found: usize, expected: usize, meant: String } => "the array has {found} values, and {expected} are needed", help: "numbers have a decimal point, not a comma: is `{meant}` meant?";
        }
        E0180 "the result would take the place of an input",
        cause: "The result has the name of a file that the command reads, or a directory in which one has the name of a result.",
        cure: "Give another name.",
        asks: [Out, Save] {
            IsInput => "is read by this command, and its result would overwrite it", help: "give another name or directory for the result";
        }
        E0181 "a file that this command did not write is in the way",
        cause: "The directory has a file of the name of a result, which this command did not write: it may be the only copy of something else.",
        cure: "Give a new directory, or move the file away.",
        asks: [Out] {
            OtherContent => "exists with other content and is not replaced";
            OtherRobot { robot: String } => "is the result of the robot `{robot}`, and is not replaced by that of another";
            NoResult => "is not what this command writes under this name, and is not replaced";
        }
        I0113 "the format of a table was detected",
        cause: "The table has another delimiter, decimal sign or encoding than dbbd writes. It was detected without doubt.",
        cure: "Nothing to do, if the message names the right ones." {
            WrittenAs { encoding: String, delimiter: String, decimal: char } => "is read as {encoding}, cells cut at {delimiter}, with the decimal `{decimal}`";
        }
    }
}

findings! {
    /// A step that cannot fail with valid data.
    InternalFinding "Faults of dbbd itself" {
        E0009 "dbbd failed internally",
        cause: "A step inside dbbd failed that cannot fail with valid data: a fault of dbbd itself, or a computer without memory or threads left.",
        cure: "Repeat the command. If it fails again, report it with the command, its input files and the version of dbbd." {
            NoSystem { why: String } => "the system does not give what dbbd needs: {why}";
            NoPage { page: String, why: String } => "the page {page} cannot be made: {why}";
            NotWritten { form: &'static str, why: String } => "cannot be written as {form}: {why}";
            NotJson { why: String } => "a result of its own cannot be read as JSON: {why}";
            NoOutput { why: String } => "the output cannot be written: {why}";
        }
    }
}
