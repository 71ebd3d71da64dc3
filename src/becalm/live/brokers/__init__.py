"""MQTT and NATS: addresses, secrets and links, for sources and sinks alike."""
