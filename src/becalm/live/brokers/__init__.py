"""Addresses, logins and connections of MQTT and NATS, for sources and sinks."""
