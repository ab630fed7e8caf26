"""Files as loggers and programs write them, of one measurement: a force and an acceleration of a mass.

LOGGERS maps a name to the file's ending and a function that returns its bytes.
"""

import io

import numpy as np
import pandas

RATE_HZ = 512.0
SAMPLES = 300
TIME_S = np.arange(SAMPLES) / RATE_HZ
_RANDOM = np.random.default_rng(5)
FORCE_N = np.round(20 * _RANDOM.standard_normal(SAMPLES), 5)
ACCELERATION = np.round(3 * _RANDOM.standard_normal(SAMPLES), 6)
"""m/s^2."""
TRIGGER = np.where(TIME_S > 0.2, 5.0, 0.0)
TABLE = np.stack([TIME_S, FORCE_N, ACCELERATION], axis=1)


def rows(table=TABLE, delimiter=",", digits="%.10g", decimal=".", line_end="\n", after=""):
    lines = (delimiter.join(digits % value for value in row).replace(".", decimal) + after for row in table)
    return line_end.join(lines) + line_end


def labview_lvm():
    head = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Reader_Version\t2",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "Multi_Headings\tNo",
        "X_Columns\tOne",
        "Time_Pref\tRelative",
        "Operator\tlab",
        "Date\t2024/03/01",
        "Time\t14:05:06.7890000\t",
        "***End_of_Header***\t",
        "\t",
        "Channels\t2\t\t",
        f"Samples\t{SAMPLES}\t{SAMPLES}\t",
        "Date\t2024/03/01\t2024/03/01\t",
        "Time\t14:05:06.7890000\t14:05:06.7890000\t",
        "Y_Unit_Label\tN\tm/s^2\t",
        "X_Dimension\tTime\tTime\t",
        "X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t",
        "Delta_X\t0.001953125\t0.001953125\t",
        "***End_of_Header***\t\t\t",
        "X_Value\tForce\tAcc tip\tComment",
    ]
    return ("\r\n".join(head) + "\r\n" + rows(delimiter="\t", line_end="\r\n", after="\t")).encode()


def yokogawa():
    """A label before each line of the header, of which several may pass for units."""
    head = [
        '"Header Size",14',
        '"Model Name","DL850E"',
        '"BlockNumber",1',
        '"TraceName","Force","Acc tip"',
        f'"BlockSize",{SAMPLES},{SAMPLES}',
        '"VUnit","N","m/s2"',
        '"HResolution",1.953125E-03,1.953125E-03',
        '"HOffset",0.0E+00,0.0E+00',
        '"HUnit","s","s"',
        '"DisplayPointNo.",1,1',
        '"Date","2024/03/01","2024/03/01"',
        '"Time","14:05:06.00","14:05:06.00"',
        "",
    ]
    return ("\n".join(head) + "\n" + rows(TABLE[:, 1:])).encode()


def catman():
    head = [
        "HBM_CATMANEASY_ASCII",
        "T0 = 01.03.2024 14:05:06",
        "Kommentar:\tPrüfstand 3, 20 °C",
        "",
        "Zeit  1 - Standardmessrate\tKraft\tBeschl. Spitze\tTemperatur",
        "Abtastrate: 512 Hz\t512 Hz\t512 Hz\t512 Hz",
        "s\tN\tm/s²\t°C",
    ]
    table = np.column_stack([TABLE, 20 + 0.01 * TIME_S])
    return ("\r\n".join(head) + "\r\n" + rows(table, "\t", "%.6f", ",", "\r\n")).encode("latin-1")


def bruel_kjaer():
    head = [
        "Header Size:\t11",
        "Version:\t7",
        "System:\tPULSE LabShop",
        "Title1:\tTime(Force) - Input",
        "Date:\t01-Mar-2024",
        "Time:\t14:05:06",
        f"X-Axis size:\t{SAMPLES}",
        "X-Axis unit:\ts",
        "X-axis delta:\t1.953125e-03",
        "Y-Axis unit:\tN\tm/s^2",
        "Number\tTime[s]\tForce[N]\tAcc tip[m/s²]",
    ]
    table = np.column_stack([np.arange(1, SAMPLES + 1), TABLE])
    return ("\r\n".join(head) + "\r\n" + rows(table, "\t", "%.8e", ".", "\r\n")).encode("cp1252")


def simcenter():
    head = ["Project: demo", "Run: Run 1", "Original section: 2024-03-01 14:05:06", ""]
    names = "Time\tHammer:+Z\tTip:+Z"
    units = "s\tN\tm/s^2"
    return ("\n".join([*head, names, units]) + "\n" + rows(delimiter="\t", digits="%.8e")).encode()


def dewesoft():
    head = [
        "File name: Test_0001.dxd",
        "Start time: 2024-03-01 14:05:06.000",
        "Number of channels: 3",
        "Sample rate: 512",
        "Store type: always fast",
        "",
        "Data1",
        "Time (s),Force (N),Acc tip (m/s2),Trigger (V)",
    ]
    return ("\n".join(head) + "\n" + rows(np.column_stack([TABLE, TRIGGER]))).encode()


def excel_german():
    head = "sep=;\r\nMessung vom 01.03.2024 14:05:06;;;\r\nZeit [s];Kraft [N];Beschl. [m/s²];\r\n"
    return (head + rows(delimiter=";", decimal=",", line_end="\r\n", after=";")).encode("cp1252")


def excel_german_units_line():
    head = "Zeit;Kraft;Beschleunigung\r\n[s];[N];[m/s²]\r\n"
    return ("\ufeff" + head + rows(delimiter=";", decimal=",", line_end="\r\n")).encode()


def writematrix():
    return rows(digits="%.15g").encode()


def writetable():
    return ("t,F_N,acc1\n" + rows(digits="%.15g")).encode()


def to_csv():
    frame = pandas.DataFrame({"time": TIME_S, "F (N)": FORCE_N, "acc tip [m/s^2]": ACCELERATION})
    return frame.to_csv().encode()


def to_csv_dated():
    index = pandas.date_range("2024-03-01 14:05:06", periods=SAMPLES, freq=pandas.Timedelta(1 / RATE_HZ, "s"))
    frame = pandas.DataFrame({"F (N)": FORCE_N, "acc tip [m/s^2]": ACCELERATION}, index=index)
    return frame.to_csv().encode()


def savetxt():
    stream = io.StringIO()
    np.savetxt(stream, TABLE, header="t F a", fmt="%.9e")
    return stream.getvalue().encode()


def tektronix():
    head = [
        "Model,MSO2024",
        "Firmware Version,1.56",
        "",
        "Point Format,Y,",
        "Horizontal Units,S,",
        "Horizontal Scale,0.04,",
        "Sample Interval,0.001953125,",
        f"Record Length,{SAMPLES},",
        "Probe Attenuation,1,1",
        "Vertical Units,V,V",
        "Label,,",
        "",
        "TIME,CH1,CH2",
    ]
    table = np.column_stack([TIME_S - 0.1, 0.01 * FORCE_N, 0.1 * ACCELERATION])
    return ("\n".join(head) + "\n" + rows(table)).encode()


def keysight():
    table = np.column_stack([TIME_S, 0.01 * FORCE_N, 0.1 * ACCELERATION])
    return ("x-axis,1,2\nsecond,Volt,Volt\n" + rows(table, digits="%.8E")).encode()


def rigol():
    table = np.column_stack([np.arange(SAMPLES), 0.01 * FORCE_N, 0.1 * ACCELERATION])
    return ("X,CH1,CH2,Start,Increment,\nSequence,VOLT,VOLT,-3.0e-01,1.953125e-03\n" + rows(table, after=",,")).encode()


def utf16():
    return ("\ufeffTime / ms\tForce / N\tAcc / m/s²\r\n" + rows(TABLE * [1e3, 1, 1], "\t", line_end="\r\n")).encode(
        "utf-16-le"
    )


def ragged():
    text = "Time [s];Force [N];Acc [g]\n" + rows(TABLE * [1, 1, 1 / 9.80665], ";", "%.12g")
    return (text + "0.5859375;3.5;\n0.587890625;;\n;;\nEnd of data\n").encode()


def slow_channel():
    """Of a slow channel there is a value in every tenth line."""
    lines = rows(digits="%.12g").splitlines()
    slow = [f"{line},{20 + 0.001 * k if k % 10 == 0 else ''}" for k, line in enumerate(lines)]
    return ("Time (s),Force (N),Acc (m/s^2),Level (mm)\n" + "\n".join(slow) + "\n").encode()


def milliseconds():
    """Time stamps of three digits, of which several are equal or uneven."""
    lines = [f"{round(t, 3):.3f},{f!r},{a!r}" for t, f, a in TABLE.tolist()]
    return ("Date: 3/14/2024 2:05:06 PM\nTime [s],Force [N],Acc [m/s^2]\n" + "\n".join(lines) + "\n").encode()


def no_time():
    return ("Sampling rate [Hz];512\nForce [N];Acc [m/s^2]\n" + rows(TABLE[:, 1:], ";", decimal=",")).encode()


def imc():
    head = "Zeit\tKraft\tBeschl\n[s]\t[N]\t[m/s²]\n"
    return ("# imc FAMOS 01.03.2024 14:05:06\n" + head + rows(delimiter="\t", decimal=",")).encode("latin-1")


LOGGERS = {
    "labview": (".lvm", labview_lvm),
    "yokogawa": (".csv", yokogawa),
    "catman": (".asc", catman),
    "bruel_kjaer": (".txt", bruel_kjaer),
    "simcenter": (".txt", simcenter),
    "dewesoft": (".csv", dewesoft),
    "excel_german": (".csv", excel_german),
    "excel_german_units_line": (".csv", excel_german_units_line),
    "writematrix": (".csv", writematrix),
    "writetable": (".csv", writetable),
    "to_csv": (".csv", to_csv),
    "to_csv_dated": (".csv", to_csv_dated),
    "savetxt": (".txt", savetxt),
    "tektronix": (".csv", tektronix),
    "keysight": (".csv", keysight),
    "rigol": (".csv", rigol),
    "utf16": (".txt", utf16),
    "ragged": (".csv", ragged),
    "slow_channel": (".csv", slow_channel),
    "milliseconds": (".csv", milliseconds),
    "no_time": (".csv", no_time),
    "imc": (".tsv", imc),
}
