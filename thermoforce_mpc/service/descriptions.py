"""What the test case itself says about its points: part of the protocol, which clients show or search.

Labels as the service of BOPTEST answers them (github.com/ibpsa/project1-boptest, replies of /inputs, /measurements and
/forecast_points of `bestest_hydronic_heat_pump`), kept to the letter, slips of the pen included.
"""

from __future__ import annotations

OVERWRITES = {
    "oveHeaPumY": "Heat pump modulating signal for compressor speed between 0 (not working) "
    "and 1 (working at maximum capacity)",
    "oveTSet": "Zone operative temperature setpoint",
    "ovePum": "Integer signal to control the emission circuit pump either on or off",
    "oveFan": "Integer signal to control the heat pump evaporator fan either on or off",
}
MEASUREMENTS = {
    "reaTZon_y": "Zone operative temperature",
    "reaPHeaPum_y": "Heat pump electrical power",
    "reaPFan_y": "Electrical power of the heat pump evaporator fan",
    "reaPPumEmi_y": "Emission circuit pump electrical power",
    "reaQHeaPumCon_y": "Heat pump thermal power exchanged in the condenser",
    "reaQHeaPumEva_y": "Heat pump thermal power exchanged in the evaporator",
    "reaQFloHea_y": "Floor heating thermal power released to the zone",
    "reaTSup_y": "Supply water temperature to radiant floor",
    "reaTRet_y": "Return water temperature from radiant floor",
    "reaCOP_y": "Heat pump COP",
    "reaTSetHea_y": "Zone operative temperature setpoint for heating",
    "reaTSetCoo_y": "Zone operative temperature setpoint for cooling",
    "reaCO2RooAir_y": "CO2 concentration in the zone",
}
# By the forecast's name of the signal that the weather station measures.
STATION = {
    "HDifHor": "Horizontal diffuse solar radiation measurement",
    "HDirNor": "Direct normal radiation measurement",
    "HGloHor": "Global horizontal solar irradiation measurement",
    "HHorIR": "Horizontal infrared irradiation measurement",
    "TBlaSky": "Black-body sky temperature measurement",
    "TDewPoi": "Dew point temperature measurement",
    "TDryBul": "Outside drybulb temperature measurement",
    "TWetBul": "Wet bulb temperature measurement",
    "ceiHei": "Cloud cover ceiling height measurement",
    "cloTim": "Day number with units of seconds",
    "lat": "Latitude of the location",
    "lon": "Longitude of the location",
    "nOpa": "Opaque sky cover measurement",
    "nTot": "Sky cover measurement",
    "pAtm": "Atmospheric pressure measurement",
    "relHum": "Outside relative humidity measurement",
    "solAlt": "Solar altitude angle measurement",
    "solDec": "Solar declination angle measurement",
    "solHouAng": "Solar hour angle measurement",
    "solTim": "Solar time",
    "solZen": "Solar zenith angle measurement",
    "winDir": "Wind direction measurement",
    "winSpe": "Wind speed measurement",
}
FORECAST = {
    "EmissionsElectricPower": "Kilograms of carbon dioxide to produce 1 kWh of electricity",
    "HDifHor": "Horizontal diffuse solar radiation",
    "HDirNor": "Direct normal radiation",
    "HGloHor": "Horizontal global radiation",
    "HHorIR": "Horizontal infrared irradiation",
    "InternalGainsCon[1]": "Convective internal gains of zone",
    "InternalGainsLat[1]": "Latent internal gains of zone",
    "InternalGainsRad[1]": "Radiative internal gains of zone",
    "LowerSetp[1]": "Lower temperature set point for thermal comfort of zone",
    "Occupancy[1]": "Number of occupants of zone",
    "PriceElectricPowerConstant": "Completely constant electricity price",
    "PriceElectricPowerDynamic": "Electricity price for a day/night tariff",
    "PriceElectricPowerHighlyDynamic": "Spot electricity price",
    "TBlaSky": "Black Sky temperature",
    "TDewPoi": "Dew point temperature",
    "TDryBul": "Dry bulb temperature at ground level",
    "TWetBul": "Wet bulb temperature",
    "UpperCO2[1]": "Upper CO2 set point for indoor air quality of zone",
    "UpperSetp[1]": "Upper temperature set point for thermal comfort of zone",
    "ceiHei": "Ceiling height",
    "cloTim": "One-based day number in seconds",
    "lat": "Latitude of the location",
    "lon": "Longitude of the location",
    "nOpa": "Opaque sky cover [0, 1]",
    "nTot": "Total sky Cover [0, 1]",
    "pAtm": "Atmospheric pressure",
    "relHum": "Relative Humidity",
    "solAlt": "Altitude angel",
    "solDec": "Declination angle",
    "solHouAng": "Solar hour angle.",
    "solTim": "Solar time",
    "solZen": "Zenith angle",
    "winDir": "Wind direction",
    "winSpe": "Wind speed",
}
